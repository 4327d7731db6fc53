#include "node/parameter_values.hpp"

#include "core/numbers.hpp"
#include "node/user_error.hpp"

namespace ces
{

rcl_interfaces::msg::ParameterDescriptor describe(const std::string & meaning, bool is_live)
{
  rcl_interfaces::msg::ParameterDescriptor descriptor;
  descriptor.description = meaning;
  descriptor.read_only = !is_live;
  descriptor.dynamic_typing = true;  // whole numbers are numbers, too
  return descriptor;
}

std::string quote(const rclcpp::ParameterValue & value)
{
  const auto text = rclcpp::to_string(value);
  return value.get_type() == rclcpp::PARAMETER_STRING ? "'" + text + "'" : text;
}

std::optional<double> find_number(const rclcpp::ParameterValue & value)
{
  if (value.get_type() == rclcpp::PARAMETER_INTEGER) {return static_cast<double>(value.get<int64_t>());}
  if (value.get_type() == rclcpp::PARAMETER_DOUBLE) {return value.get<double>();}
  return std::nullopt;
}

double check_number(const NumberSpec & spec, const rclcpp::ParameterValue & value)
{
  const auto number = find_number(value);
  const auto where = std::string("parameter '") + spec.name + "' is " + quote(value);
  if (!number) {throw UserError(where + "; expected a number");}
  if (!(spec.lowest <= *number && *number <= spec.highest)) {
    throw UserError(
      where + "; expected " + format_number("%g", spec.lowest) + " to " + format_number("%g", spec.highest));
  }
  return *number;
}

int64_t declare_whole(rclcpp::Node & node, const WholeSpec & spec)
{
  const auto value = node.declare_parameter(spec.name, rclcpp::ParameterValue(spec.value), describe(spec.meaning));
  const auto where = std::string("parameter '") + spec.name + "' is " + quote(value);
  if (value.get_type() != rclcpp::PARAMETER_INTEGER) {throw UserError(where + "; expected a whole number");}
  const auto number = value.get<int64_t>();
  if (number < spec.lowest || number > spec.highest) {
    throw UserError(where + "; expected " + std::to_string(spec.lowest) + " to " + std::to_string(spec.highest));
  }
  return number;
}

std::string declare_text(
  rclcpp::Node & node, const std::string & name, const std::string & value, const std::string & meaning)
{
  const auto read = node.declare_parameter(name, rclcpp::ParameterValue(value), describe(meaning));
  if (read.get_type() != rclcpp::PARAMETER_STRING) {
    throw UserError("parameter '" + name + "' is " + quote(read) + "; expected a string");
  }
  return read.get<std::string>();
}

}  // namespace ces
