// This process: its load, and the datagrams that the kernel dropped because it did not read them in time.
#pragma once

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <thread>
#include <type_traits>

#include <diagnostic_updater/diagnostic_status_wrapper.hpp>

#include "core/clocks.hpp"
#include "from_python.hpp"

namespace ces {

using Status = diagnostic_updater::DiagnosticStatusWrapper;

// Add a value; `names` take the places of {} in its key.
template<typename Value, typename ... Names>
void add(Status & status, const Figure & figure, const Value & value, const Names & ... names) {
  std::string key = figure.key;
  (key.replace(key.find("{}"), 2, names), ...);
  if constexpr (std::is_floating_point_v<Value>) {
    status.addf(key, figure.form, value);
  } else if constexpr (std::is_convertible_v<Value, std::string>) {
    status.addf(key, figure.form, std::string(value).c_str());
  } else {
    status.add(key, value);
  }
}

// Processor load between two calls of `roll`, as shares of one core: of the process and of the calling thread, which is
// to run the executor.
class LoadMeter {
public:
  LoadMeter() {roll();}

  void roll() {
    before_ = now_;
    for (std::size_t k = 0; k < CLOCKS.size(); ++k) {now_[k] = static_cast<double>(read_clock(CLOCKS[k]));}
  }

  void add_values(Status & status) const {
    for (const auto & [k, name] : {std::pair(1, "process"), std::pair(2, "executor")}) {
      const auto share = (now_[k] - before_[k]) / std::max(1.0, now_[0] - before_[0]);
      add(status, figures::LOAD, 100.0 * share, name);
    }
  }

private:
  static constexpr std::array CLOCKS{CLOCK_MONOTONIC, CLOCK_PROCESS_CPUTIME_ID, CLOCK_THREAD_CPUTIME_ID};

  std::array<double, CLOCKS.size()> now_{}, before_{};
};

// A full receive buffer loses messages before DDS sees them. With shared memory instead of UDP nothing is counted.
class KernelDrops {
public:
  // Count; the first call finds the sockets of DDS.
  void roll() {
    if (!sockets_) {
      sockets_ = find_sockets();
      drops_ = start_ = count();
    }
    const auto before = std::exchange(drops_, std::max(drops_, count()));
    new_ = drops_ - before;
  }

  // A remark on datagrams that were dropped before the last `roll`, empty if there were none.
  std::string find_remark() const {
    if (new_ == 0) {return "";}
    return "the kernel dropped " + std::to_string(new_) +
           " datagrams in the last second: set net.core.rmem_max higher";
  }

  void add_values(Status & status) const {status.add("datagrams dropped by the kernel", drops_ - start_);}

private:
  static constexpr std::size_t MAX_SOCKETS = 10'000;  // lines of a table that are read
  static constexpr std::size_t INODE = 9, DROPS = 12;  // columns

  // The inodes of the process' sockets, as the kernel's tables name them.
  static std::set<std::string> find_sockets() {
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

  std::uint64_t count() const {
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

  std::optional<std::set<std::string>> sockets_;  // their inodes
  std::uint64_t start_ = 0, drops_ = 0, new_ = 0;
};

}  // namespace ces
