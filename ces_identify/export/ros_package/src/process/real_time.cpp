#include "process/real_time.hpp"

#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <system_error>
#include <thread>

namespace ces
{
namespace
{

namespace files = std::filesystem;

constexpr unsigned long long CAP_LOCK = 1ULL << 14;  // CAP_IPC_LOCK of capabilities(7)
constexpr const char * HOW_PRIORITY =
  "allow it with 'rtprio' in /etc/security/limits.conf, LimitRTPRIO= of systemd, or CAP_SYS_NICE";
constexpr const char * HOW_LOCK =
  "set 'memlock unlimited' in /etc/security/limits.conf, LimitMEMLOCK=infinity of systemd, or CAP_IPC_LOCK";

std::vector<pid_t> list_threads()
{
  std::vector<pid_t> threads;
  std::error_code error;
  for (files::directory_iterator entry("/proc/self/task", error), end; !error && entry != end; entry.increment(error)) {
    threads.push_back(static_cast<pid_t>(std::strtol(entry->path().filename().c_str(), nullptr, 10)));
  }
  return threads;
}

// A field of this process' status; empty if it is not there.
std::string read_status(const std::string & name)
{
  std::ifstream file("/proc/self/status");
  for (std::string line; std::getline(file, line); ) {
    if (line.rfind(name + ":", 0) == 0) {return line.substr(line.find_first_not_of(" \t", name.size() + 1));}
  }
  return "";
}

std::string list_processors(const std::vector<std::size_t> & processors)
{
  std::string text;
  for (const auto number : processors) {text += (text.empty() ? "" : ",") + std::to_string(number);}
  return text;
}

// Set SCHED_FIFO for all threads; processes that they start have the ordinary policy again.
void set_priority(int priority, std::vector<std::string> & problems)
{
  const auto own = gettid();
  for (const auto thread : list_threads()) {
    sched_param parameters{};
    parameters.sched_priority = priority + (thread != own);
    if (sched_setscheduler(thread, SCHED_FIFO | SCHED_RESET_ON_FORK, &parameters) == 0 || errno == ESRCH) {continue;}
    const auto what = "realtime_priority " + std::to_string(priority) + " is not ";
    problems.push_back(what + (errno == EPERM ? std::string("permitted: ") + HOW_PRIORITY :
      std::string("possible: ") + std::strerror(errno)));
    return;
  }
}

void set_processors(const std::vector<std::size_t> & processors, std::vector<std::string> & problems)
{
  cpu_set_t set;
  CPU_ZERO(&set);
  for (const auto number : processors) {CPU_SET(number, &set);}
  for (const auto thread : list_threads()) {
    if (sched_setaffinity(thread, sizeof set, &set) == 0 || errno == ESRCH) {continue;}
    problems.push_back(
      "cpu_affinity " + list_processors(processors) + " is not possible: " + std::strerror(errno) +
      "; the computer has " + std::to_string(std::thread::hardware_concurrency()) + " processors");
    return;
  }
}

// Lock all memory, unless a limit would make later allocations fail.
void lock_memory(std::vector<std::string> & problems)
{
  rlimit limit{};
  const bool unlimited = getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY;
  if (!unlimited && !(std::strtoull(read_status("CapEff").c_str(), nullptr, 16) & CAP_LOCK)) {
    problems.push_back(std::string("lock_memory is not permitted: ") + HOW_LOCK);
  } else if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0) {  // pages are locked when they are first used
    problems.push_back(std::string("lock_memory is not possible: ") + std::strerror(errno));
  }
}

std::string describe_scheduling()
{
  const int policy = sched_getscheduler(0) & ~SCHED_RESET_ON_FORK;
  const std::string name = policy == SCHED_FIFO ? "SCHED_FIFO" : policy == SCHED_RR ? "SCHED_RR" :
    policy == SCHED_OTHER ? "SCHED_OTHER" : std::to_string(policy);
  sched_param parameters{};
  sched_getparam(0, &parameters);
  const auto priority = parameters.sched_priority;
  return priority ? name + ", priority " + std::to_string(priority) : name;
}

}  // namespace

std::vector<std::string> apply_options(const RealTimeOptions & options)
{
  std::vector<std::string> problems;
  if (options.priority) {set_priority(options.priority, problems);}
  if (!options.processors.empty()) {set_processors(options.processors, problems);}
  if (options.lock_memory) {lock_memory(problems);}
  return problems;
}

std::vector<std::pair<std::string, std::string>> describe_options()
{
  cpu_set_t set;
  CPU_ZERO(&set);
  sched_getaffinity(0, sizeof set, &set);
  std::vector<std::size_t> processors;
  for (std::size_t k = 0; k < CPU_SETSIZE; ++k) {
    if (CPU_ISSET(k, &set)) {processors.push_back(k);}
  }
  const bool locked = std::strtoull(read_status("VmLck").c_str(), nullptr, 10) > 0;
  return {
    {"scheduling", describe_scheduling()}, {"processors", list_processors(processors)},
    {"memory locked", locked ? "yes" : "no"}};
}

}  // namespace ces
