// This process: its load, its real-time options (SCHED_FIFO, processors, locked memory), and datagrams it has lost.
//
// All threads of the process are set, those of DDS with it: its receiving thread must read a datagram before the
// kernel's buffer is full, so it gets the next higher priority. Threads and processes that start later are ordinary
// ones. What is not permitted is a warning.
#pragma once

#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <thread>

#include <diagnostic_updater/diagnostic_status_wrapper.hpp>

#include "core/clocks.hpp"

namespace ces
{

using Status = diagnostic_updater::DiagnosticStatusWrapper;

// Processor load between two calls of `roll`, as shares of one core: of the process and of the calling thread, which is
// to run the executor.
class LoadMeter
{
public:
  void roll()
  {
    before_ = now_;
    for (std::size_t k = 0; k < CLOCKS.size(); ++k) {now_[k] = static_cast<double>(read_clock(CLOCKS[k]));}
  }

  void add_values(Status & status) const
  {
    for (const auto & [k, name] : {std::pair(1, "process"), std::pair(2, "executor")}) {
      const auto share = (now_[k] - before_[k]) / std::max(1.0, now_[0] - before_[0]);
      status.addf(std::string(name) + " load [% of a core]", "%.1f", 100.0 * share);
    }
  }

private:
  static constexpr std::array CLOCKS{CLOCK_MONOTONIC, CLOCK_PROCESS_CPUTIME_ID, CLOCK_THREAD_CPUTIME_ID};

  std::array<double, CLOCKS.size()> now_{}, before_{};
};

struct RealTimeOptions
{
  int priority = 0;  // of SCHED_FIFO; 0: ordinary scheduling
  std::vector<std::int64_t> processors;  // empty: all
  bool lock_memory = false;
};

// Call its functions in the executor.
class Process
{
public:
  explicit Process(RealTimeOptions options)
  : options_(std::move(options)) {}

  // Count the datagrams that the kernel dropped because this process did not read them in time. A full receive buffer
  // loses messages before DDS sees them. With shared memory instead of UDP nothing is counted.
  //
  // The first call, when all threads of the executor and of DDS run, puts the options in force; it returns a warning of
  // those that are not, empty if there is none.
  std::string roll()
  {
    if (sockets_) {
      const auto drops = std::max(drops_, count_drops());
      new_drops_ = drops - drops_;
      drops_ = drops;
      return "";
    }
    sockets_ = find_sockets();
    drops_ = start_ = count_drops();
    std::vector<std::string> problems{set_priority(), set_processors(), lock_memory()};
    problems.erase(std::remove(problems.begin(), problems.end(), ""), problems.end());
    return problems.empty() ? "" : "real-time options that are not in force: " + join(problems, "; ");
  }

  // A remark on datagrams that were dropped before the last `roll`, empty if there were none.
  std::string find_remark() const
  {
    if (!new_drops_) {return "";}
    return "the kernel dropped " + std::to_string(new_drops_) +
           " datagrams in the last second: set net.core.rmem_max higher";
  }

  // Add what is in force.
  void add_values(Status & status) const
  {
    const int policy = sched_getscheduler(0) & ~SCHED_RESET_ON_FORK;
    const std::string name = policy == SCHED_FIFO ? "SCHED_FIFO" : policy == SCHED_RR ? "SCHED_RR" :
      policy == SCHED_OTHER ? "SCHED_OTHER" : std::to_string(policy);
    sched_param parameters{};
    sched_getparam(0, &parameters);
    const auto priority = parameters.sched_priority;
    cpu_set_t set;
    CPU_ZERO(&set);
    sched_getaffinity(0, sizeof set, &set);
    std::vector<std::string> processors;
    for (std::size_t k = 0; k < CPU_SETSIZE; ++k) {
      if (CPU_ISSET(k, &set)) {processors.push_back(std::to_string(k));}
    }
    const bool locked = std::strtoull(read_status("VmLck").c_str(), nullptr, 10) > 0;
    status.add("scheduling", name + (priority ? ", priority " + std::to_string(priority) : ""));
    status.add("processors", join(processors, ","));
    status.add("memory locked", locked ? "yes" : "no");
    status.add("datagrams dropped by the kernel", drops_ - start_);
  }

private:
  static constexpr unsigned long long CAP_LOCK = 1ULL << 14;  // CAP_IPC_LOCK of capabilities(7)
  static constexpr std::size_t MAX_SOCKETS = 10'000;  // lines of a table that are read
  static constexpr std::size_t INODE = 9, DROPS = 12;  // columns

  // Set SCHED_FIFO for all threads; processes that they start have the ordinary policy again.
  std::string set_priority() const
  {
    if (options_.priority == 0) {return "";}
    const auto own = gettid();
    const auto error = for_all_threads([&](pid_t thread) {
          sched_param parameters{};
          parameters.sched_priority = options_.priority + (thread != own);
          return sched_setscheduler(thread, SCHED_FIFO | SCHED_RESET_ON_FORK, &parameters);
        });
    if (error == 0) {return "";}
    const auto what = "realtime_priority " + std::to_string(options_.priority) + " is not ";
    return what + (error != EPERM ? std::string("possible: ") + std::strerror(error) :
           "permitted: allow it with 'rtprio' in /etc/security/limits.conf, LimitRTPRIO= of systemd, or CAP_SYS_NICE");
  }

  std::string set_processors() const
  {
    if (options_.processors.empty()) {return "";}
    cpu_set_t set;
    CPU_ZERO(&set);
    for (const auto number : options_.processors) {CPU_SET(static_cast<std::size_t>(number), &set);}
    const auto error = for_all_threads([&](pid_t thread) {return sched_setaffinity(thread, sizeof set, &set);});
    if (error == 0) {return "";}
    std::string list;
    for (const auto number : options_.processors) {list += (list.empty() ? "" : ",") + std::to_string(number);}
    return "cpu_affinity " + list + " is not possible: " + std::strerror(error) + "; the computer has " +
           std::to_string(std::thread::hardware_concurrency()) + " processors";
  }

  // Lock all memory, unless a limit would make later allocations fail.
  std::string lock_memory() const
  {
    if (!options_.lock_memory) {return "";}
    rlimit limit{};
    const bool unlimited = getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY;
    if (!unlimited && !(std::strtoull(read_status("CapEff").c_str(), nullptr, 16) & CAP_LOCK)) {
      return "lock_memory is not permitted: set 'memlock unlimited' in /etc/security/limits.conf, "
             "LimitMEMLOCK=infinity of systemd, or CAP_IPC_LOCK";
    }
    if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0) {return "";}  // pages are locked when first used
    return std::string("lock_memory is not possible: ") + std::strerror(errno);
  }

  // Call `set` with each thread; returns the first error but that of a thread that has ended, 0 if there is none.
  template<typename Set>
  static int for_all_threads(const Set & set)
  {
    std::error_code ended;
    for (const auto & entry : std::filesystem::directory_iterator("/proc/self/task", ended)) {
      const auto thread = std::strtol(entry.path().filename().c_str(), nullptr, 10);
      if (set(static_cast<pid_t>(thread)) != 0 && errno != ESRCH) {return errno;}
    }
    return 0;
  }

  // A field of this process' status; empty if it is not there.
  static std::string read_status(const std::string & name)
  {
    std::ifstream file("/proc/self/status");
    for (std::string line; std::getline(file, line); ) {
      if (line.rfind(name + ":", 0) == 0) {return line.substr(name.size() + 1);}
    }
    return "";
  }

  // The inodes of the process' sockets, as the kernel's tables name them.
  static std::set<std::string> find_sockets()
  {
    const std::string socket = "socket:[";
    std::set<std::string> inodes;
    std::error_code error;
    for (const auto & entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
      const auto target = std::filesystem::read_symlink(entry.path(), error).string();  // empty: closed meanwhile
      const bool is_socket = target.rfind(socket, 0) == 0 && target.back() == ']';
      if (is_socket) {inodes.insert(target.substr(socket.size(), target.size() - socket.size() - 1));}
    }
    return inodes;
  }

  std::uint64_t count_drops() const
  {
    std::uint64_t drops = 0;
    for (const auto * table : {"/proc/self/net/udp", "/proc/self/net/udp6"}) {
      std::ifstream file(table);
      std::string line;
      for (std::size_t k = 0; k < MAX_SOCKETS && std::getline(file, line); ++k) {
        std::istringstream words(line);
        const std::vector<std::string> columns{std::istream_iterator<std::string>(words), {}};
        const bool is_own = columns.size() > DROPS && sockets_->count(columns[INODE]);
        if (is_own) {drops += std::strtoull(columns[DROPS].c_str(), nullptr, 10);}
      }
    }
    return drops;
  }

  RealTimeOptions options_;
  std::optional<std::set<std::string>> sockets_;  // their inodes
  std::uint64_t start_ = 0, drops_ = 0, new_drops_ = 0;
};

}  // namespace ces
