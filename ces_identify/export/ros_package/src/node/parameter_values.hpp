// Declares single parameters, with their meaning, and checks their values.
#ifndef NODE__PARAMETER_VALUES_HPP_
#define NODE__PARAMETER_VALUES_HPP_

#include <cstdint>
#include <optional>
#include <string>

#include <rclcpp/node.hpp>

namespace ces
{

struct NumberSpec {const char * name; double value, lowest, highest; const char * meaning;};

struct WholeSpec {const char * name; int64_t value, lowest, highest; const char * meaning;};

// The descriptor of a parameter that may have a value of any type, such as a whole number for a number.
rcl_interfaces::msg::ParameterDescriptor describe(const std::string & meaning, bool is_live = false);

// A value as errors show it.
std::string quote(const rclcpp::ParameterValue & value);

// The number, whole or not; nothing for another type.
std::optional<double> find_number(const rclcpp::ParameterValue & value);

// Each of these returns the value, and raises UserError if it is not allowed.
double check_number(const NumberSpec & spec, const rclcpp::ParameterValue & value);
std::int64_t declare_whole(rclcpp::Node & node, const WholeSpec & spec);
std::string declare_text(
  rclcpp::Node & node, const std::string & name, const std::string & value, const std::string & meaning);

}  // namespace ces

#endif  // NODE__PARAMETER_VALUES_HPP_
