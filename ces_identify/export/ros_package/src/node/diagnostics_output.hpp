// The topic /diagnostics: a damper's status in, a DiagnosticArray out; new reasons are logged.
#ifndef NODE__DIAGNOSTICS_OUTPUT_HPP_
#define NODE__DIAGNOSTICS_OUTPUT_HPP_

#include <string>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <rclcpp/node.hpp>

#include "health/health.hpp"

namespace ces
{

class DiagnosticsOutput
{
public:
  DiagnosticsOutput(rclcpp::Node & node, const std::string & joint);

  // Publish the status, and log a new reason.
  void publish(Reason reason, const Status & status);

private:
  static constexpr Nanoseconds LOG = SECOND;  // minimum time between two lines, against floods by a flickering reason

  void log(Reason reason, const Status & status);

  rclcpp::Node & node_;
  std::string joint_;
  rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr publisher_;
  bool has_logged_ = false;
  Reason logged_ = Reason::OK;
  Nanoseconds logged_at_ = 0;
};

}  // namespace ces

#endif  // NODE__DIAGNOSTICS_OUTPUT_HPP_
