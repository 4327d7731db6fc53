#include "node/diagnostics_output.hpp"

namespace ces
{

DiagnosticsOutput::DiagnosticsOutput(rclcpp::Node & node, const std::string & joint)
: node_(node), joint_(joint),
  publisher_(node.create_publisher<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics", 10)) {}

void DiagnosticsOutput::publish(Reason reason, const Status & status)
{
  diagnostic_msgs::msg::DiagnosticStatus one;
  one.level = static_cast<decltype(one.level)>(status.level);
  one.name = std::string(node_.get_fully_qualified_name()) + ": " + joint_;
  one.message = status.message;
  one.hardware_id = joint_;
  for (const auto & [key, value] : status.values) {
    one.values.emplace_back();
    one.values.back().key = key;
    one.values.back().value = value;
  }
  auto message = std::make_unique<diagnostic_msgs::msg::DiagnosticArray>();
  message->header.stamp = node_.now();
  message->status.push_back(std::move(one));
  publisher_->publish(std::move(message));
  log(reason, status);
}

void DiagnosticsOutput::log(Reason reason, const Status & status)
{
  const auto now = read_clock(CLOCK_MONOTONIC);
  if (has_logged_ && (reason == logged_ || now - logged_at_ < LOG)) {return;}
  has_logged_ = true;
  logged_ = reason;
  logged_at_ = now;
  if (status.level == Level::OK) {
    RCLCPP_INFO(node_.get_logger(), "%s: %s", joint_.c_str(), status.message.c_str());
  } else {
    RCLCPP_WARN(node_.get_logger(), "%s: %s", joint_.c_str(), status.message.c_str());
  }
}

}  // namespace ces
