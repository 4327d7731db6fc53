// The parameters that map each signal to its topic and field.
#ifndef NODE__SIGNAL_PARAMETERS_HPP_
#define NODE__SIGNAL_PARAMETERS_HPP_

#include <optional>
#include <string>

#include <rclcpp/node.hpp>

namespace ces
{

// A signal: where it is, and how it becomes a value in SI units; or its constant value.
struct SignalSettings
{
  std::string name, topic, type, field;
  double scale = 1.0, offset = 0.0;
  double delay_s = 0.0;  // by how much later than measured the numbers are stamped
  std::optional<double> constant;

  bool is_set() const {return constant || !topic.empty();}
};

// Each declares the parameters of a signal and returns its settings, and raises UserError.
SignalSettings declare_position(rclcpp::Node & node);
SignalSettings declare_current(rclcpp::Node & node);
SignalSettings declare_motion(rclcpp::Node & node);  // not set if the model needs none

}  // namespace ces

#endif  // NODE__SIGNAL_PARAMETERS_HPP_
