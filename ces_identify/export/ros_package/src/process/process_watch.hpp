// The node's process: real-time options put in force, datagrams lost by the kernel; diagnostics out.
#ifndef PROCESS__PROCESS_WATCH_HPP_
#define PROCESS__PROCESS_WATCH_HPP_

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "process/kernel_drops.hpp"
#include "process/real_time.hpp"

namespace ces
{

class ProcessWatch
{
public:
  explicit ProcessWatch(RealTimeOptions options)
  : options_(std::move(options)) {}

  // Put the options in force, the first time, and count; call it in the executor, once a second. Returns a warning, empty
  // if there is none. By the first call all threads of the executor and of DDS run.
  std::string update()
  {
    std::string warning;
    if (!drops_) {
      drops_.emplace();
      for (const auto & problem : apply_options(options_)) {warning += (warning.empty() ? "" : "; ") + problem;}
    }
    drops_->update();
    values_ = describe_options();
    values_.emplace_back("datagrams dropped by the kernel", std::to_string(drops_->total()));
    return warning.empty() ? "" : "real-time options that are not in force: " + warning;
  }

  // The key-value pairs for diagnostics.
  const std::vector<std::pair<std::string, std::string>> & values() const {return values_;}

  // A remark on datagrams that were dropped before the last update, empty if there were none.
  std::string find_remark() const
  {
    if (!drops_ || !drops_->fresh()) {return "";}
    return "the kernel dropped " + std::to_string(drops_->fresh()) +
           " datagrams in the last second: set net.core.rmem_max higher";
  }

private:
  RealTimeOptions options_;
  std::optional<KernelDrops> drops_;
  std::vector<std::pair<std::string, std::string>> values_;
};

}  // namespace ces

#endif  // PROCESS__PROCESS_WATCH_HPP_
