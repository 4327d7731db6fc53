// Receives estimates and diagnostics in a thread of its own.
#pragma once

#include <atomic>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include "clocks.hpp"

struct Heard {Nanoseconds stamp, at;};

// The node's own counts since its start, by the keys of its diagnostics; empty before the first message.
using Counts = std::map<std::string, int64_t>;

class Listener
{
public:
  // `observed` is the full name of the node under test, `most` the number of estimates expected.
  Listener(rclcpp::Node & node, std::string observed, size_t most)
  : observed_(std::move(observed) + ":"),
    estimates_(node.create_subscription<JointState>("estimate", rclcpp::QoS(5000), [](JointState::UniquePtr) {})),
    diagnostics_(node.create_subscription<Diagnostics>("/diagnostics", rclcpp::QoS(100), [](Diagnostics::UniquePtr) {}))
  {
    heard_.reserve(most);
    waits_.add_subscription(estimates_);
    waits_.add_subscription(diagnostics_);
    thread_ = std::thread([this] {listen();});
  }

  ~Listener() {stop();}

  std::vector<Heard> end()
  {
    stop();
    return std::move(heard_);
  }

  bool is_matched() const {return estimates_->get_publisher_count() > 0;}

  Counts counts()
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    return counts_;
  }

private:
  using JointState = sensor_msgs::msg::JointState;
  using Diagnostics = diagnostic_msgs::msg::DiagnosticArray;

  void stop()
  {
    running_ = false;
    if (thread_.joinable()) {thread_.join();}
  }

  void listen()
  {
    JointState estimate;
    Diagnostics diagnostics;
    rclcpp::MessageInfo info;
    while (running_) {
      if (waits_.wait(std::chrono::milliseconds(100)).kind() != rclcpp::WaitResultKind::Ready) {continue;}
      while (estimates_->take(estimate, info)) {
        heard_.push_back({estimate.header.stamp.sec * SECOND + estimate.header.stamp.nanosec, read_clock(CLOCK_REALTIME)});
      }
      while (diagnostics_->take(diagnostics, info)) {count(diagnostics);}
    }
  }

  void count(const Diagnostics & diagnostics)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (const auto & status : diagnostics.status) {
      if (status.name.compare(0, observed_.size(), observed_) != 0) {continue;}
      for (const auto & pair : status.values) {
        if (is_count(pair.key)) {counts_[pair.key] = std::atoll(pair.value.c_str());}
      }
    }
  }

  static bool is_count(const std::string & key)
  {
    return key == "position samples" || key == "forces estimated" || key.compare(0, 10, "withheld: ") == 0;
  }

  std::string observed_;
  rclcpp::Subscription<JointState>::SharedPtr estimates_;
  rclcpp::Subscription<Diagnostics>::SharedPtr diagnostics_;
  rclcpp::WaitSet waits_;
  std::vector<Heard> heard_;
  std::mutex mutex_;
  Counts counts_;
  std::atomic<bool> running_{true};
  std::thread thread_;
};
