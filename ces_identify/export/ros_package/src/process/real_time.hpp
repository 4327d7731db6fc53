// Real-time options of this process: SCHED_FIFO, processors and locked memory; what is not permitted is a warning.
//
// All threads of the process are set, those of DDS with it: its receiving thread must read a datagram before the kernel's
// buffer is full, so it gets the next higher priority. Threads and processes that start later are ordinary ones.
#ifndef PROCESS__REAL_TIME_HPP_
#define PROCESS__REAL_TIME_HPP_

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

namespace ces
{

constexpr int MAX_PRIORITY = 98;  // of the executor; the threads of DDS have one more
constexpr std::size_t MAX_PROCESSORS = 1024;

struct RealTimeOptions
{
  int priority = 0;  // of SCHED_FIFO; 0: ordinary scheduling
  std::vector<std::size_t> processors;  // empty: all
  bool lock_memory = false;
};

// Put the options in force, as far as possible; return why those that are not, are not. Call it in the executor.
std::vector<std::string> apply_options(const RealTimeOptions & options);

// What is in force, as key-value pairs for diagnostics; call it in the executor.
std::vector<std::pair<std::string, std::string>> describe_options();

}  // namespace ces

#endif  // PROCESS__REAL_TIME_HPP_
