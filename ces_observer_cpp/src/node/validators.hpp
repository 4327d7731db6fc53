// Checks of the parameters in parameters.yaml, in the words of the Python node.
#pragma once

#include <string>

#include <fmt/format.h>
#include <rclcpp/parameter.hpp>
#include <tl_expected/expected.hpp>

namespace ces {

using Verdict = tl::expected<void, std::string>;

// A value as Python writes it.
inline std::string quote(double value) {
  const auto text = fmt::format("{}", value);
  return text.find_first_not_of("-0123456789") == std::string::npos ? text + ".0" : text;
}
inline std::string quote(std::int64_t value) {return std::to_string(value);}
inline std::string quote(const std::string & text) {return "'" + text + "'";}

// A number from `low` to `high`.
template<typename T>
Verdict within(const rclcpp::Parameter & parameter, T low, T high) {
  const auto value = parameter.get_value<T>();
  if (low <= value && value <= high) {return {};}
  const auto kind = std::is_integral_v<T> ? "a whole number" : "a number";
  return tl::make_unexpected(
    fmt::format(
      "parameter '{}' is {}; expected {} from {:.10g} to {:.10g}", parameter.get_name(), quote(value), kind,
      double(low), double(high)));
}

}  // namespace ces
