// Heartbeats of an active node for a lifecycle manager that keeps a bond with it (ros/bond_core), as nav2's does.
#pragma once

#include <fstream>

#include <rclcpp/create_generic_publisher.hpp>

#include "core/clocks.hpp"
#include "node/settings.hpp"

namespace ces {

// Says on `bond` that the node lives. Its type is found at run time: without the package `bond` there is no bond.
class Bond {
public:
  // Begin with heartbeats every `period_s`; 0: none.
  void open(Node & node, double period_s) {
    if (period_s <= 0.0) {return;}
    std::ifstream("/proc/sys/kernel/random/uuid") >> instance_;
    id_ = node.get_name();
    period_s_ = period_s;
    try {
      publisher_ = rclcpp::create_generic_publisher(
        node.get_node_topics_interface(), "bond", "bond/msg/Status", rclcpp::QoS(10));
    } catch (const std::runtime_error &) {  // not installed
    }
  }

  // Publish a heartbeat if it is due at `now` of the steady clock.
  void watch(Nanoseconds now) {
    if (!publisher_ || now - told_ < to_ns(period_s_ - SLACK_S)) {return;}
    told_ = now;
    publish(true);
  }

  // Break the bond.
  void close() {
    if (publisher_) {publish(false);}
    publisher_.reset();
    told_ = 0;
  }

private:
  static constexpr float TIMEOUT_S = 4.0F;  // of nav2's nodes; the manager has its own
  static constexpr double SLACK_S = 0.05;  // half the period of the timer that looks whether one is due

  // Publish a bond/msg/Status, written as rosidl has it: header, id, instance_id, active, timeout, period.
  void publish(bool is_active) {
    bytes_.assign({0, 1, 0, 0});  // CDR, little endian
    const auto now = read_clock(CLOCK_REALTIME);
    add(static_cast<std::int32_t>(now / SECOND));
    add(static_cast<std::uint32_t>(now % SECOND));
    for (const auto & text : {std::string(), id_, instance_}) {
      add(static_cast<std::uint32_t>(text.size() + 1));
      bytes_.insert(bytes_.end(), text.c_str(), text.c_str() + text.size() + 1);
    }
    bytes_.push_back(is_active);
    add(TIMEOUT_S);
    add(static_cast<float>(period_s_));
    rclcpp::SerializedMessage message(bytes_.size());
    auto & raw = message.get_rcl_serialized_message();
    std::copy(bytes_.begin(), bytes_.end(), raw.buffer);
    raw.buffer_length = bytes_.size();
    publisher_->publish(message);
  }

  // Add a number of four bytes in its place.
  template<typename Number>
  void add(Number value) {
    static_assert(sizeof value == 4);
    bytes_.resize((bytes_.size() + 3) / 4 * 4);
    const auto * first = reinterpret_cast<const std::uint8_t *>(&value);
    bytes_.insert(bytes_.end(), first, first + sizeof value);
  }

  rclcpp::GenericPublisher::SharedPtr publisher_;
  std::string id_, instance_;
  double period_s_ = 0.0;
  Nanoseconds told_ = 0;
  std::vector<std::uint8_t> bytes_;
};

}  // namespace ces
