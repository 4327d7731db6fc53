// The node's parameters: declared with their meaning, and checked as the Python observer checks them.
#ifndef NODE__PARAMETERS_HPP_
#define NODE__PARAMETERS_HPP_

#include <optional>
#include <string>
#include <vector>

#include <rclcpp/node.hpp>

#include "process/real_time.hpp"

namespace ces
{

// A signal: where it is, and how it becomes a value in SI units; or its constant value.
struct SignalSettings
{
  std::string name, topic, type, field;
  double scale = 1.0, offset = 0.0;
  std::optional<double> constant;

  bool is_set() const {return constant || !topic.empty();}
};

struct Settings
{
  std::string joint, executor;
  SignalSettings position, current, motion;
  std::size_t input_depth = 0;
  RealTimeOptions real_time;
};

// The parameters that can change while the node runs.
struct LiveSettings
{
  double max_age_s = 0.0, wait_for_current_s = 0.0, still_warn_s = 0.0;
};

// Declare all parameters and return those that are read once; raises UserError.
Settings declare_settings(rclcpp::Node & node);

// The present values; raises UserError.
LiveSettings read_live_settings(const rclcpp::Node & node);

// Why one of these parameters cannot be set, empty if all can.
std::string find_refusal(const std::vector<rclcpp::Parameter> & parameters);

}  // namespace ces

#endif  // NODE__PARAMETERS_HPP_
