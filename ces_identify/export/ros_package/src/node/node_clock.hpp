// The node's time in nanoseconds, and callbacks on jumps of simulated time or the wall clock.
#ifndef NODE__NODE_CLOCK_HPP_
#define NODE__NODE_CLOCK_HPP_

#include <functional>
#include <string>

#include <rclcpp/node.hpp>

#include "core/clock_watch.hpp"
#include "health/load_meter.hpp"

namespace ces
{

class NodeClock
{
public:
  // `on_jump` is called with a line of text after each time jump.
  NodeClock(rclcpp::Node & node, std::function<void(const std::string &)> on_jump)
  : clock_(node.get_clock()), on_jump_(std::move(on_jump)),
    wall_(read_clock(CLOCK_REALTIME), read_clock(CLOCK_MONOTONIC))
  {
    rcl_jump_threshold_t threshold;
    threshold.on_clock_change = true;
    threshold.min_forward.nanoseconds = FORWARD;
    threshold.min_backward.nanoseconds = BACKWARD;
    jumps_ = clock_->create_jump_callback(
      nullptr, [this](const rcl_time_jump_t & jump) {report(jump);}, threshold);
  }

  Nanoseconds now() const {return clock_->now().nanoseconds();}

  bool is_simulated() const {return clock_->ros_time_is_active();}

  // Check whether the wall clock was set: rcl reports only jumps of simulated time.
  void watch()
  {
    const auto jump = wall_.measure_jump(read_clock(CLOCK_REALTIME), read_clock(CLOCK_MONOTONIC));
    if (jump != 0 && !is_simulated()) {
      on_jump_("the wall clock was set by " + format_number("%+.3f", to_s(jump)) + " s");
    }
  }

private:
  // The steps of /clock in a fast replay are no jumps. The samples' stamps show shorter jumps.
  static constexpr Nanoseconds FORWARD = 5 * SECOND, BACKWARD = -1'000'000;

  void report(const rcl_time_jump_t & jump)
  {
    if (jump.clock_change == RCL_ROS_TIME_ACTIVATED) {
      on_jump_("simulated time was switched on");
    } else if (jump.clock_change == RCL_ROS_TIME_DEACTIVATED) {
      on_jump_("simulated time was switched off");
    } else {
      on_jump_("simulated time jumped by " + format_number("%+.3f", to_s(jump.delta.nanoseconds)) + " s");
    }
  }

  rclcpp::Clock::SharedPtr clock_;
  std::function<void(const std::string &)> on_jump_;
  ClockWatch wall_;
  rclcpp::JumpHandler::SharedPtr jumps_;
};

}  // namespace ces

#endif  // NODE__NODE_CLOCK_HPP_
