// Checks of the parameters in parameters.yaml, in the words of the Python node.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include <fmt/ranges.h>
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

inline Verdict refuse(const rclcpp::Parameter & parameter, const std::string & value, const std::string & expected) {
  return tl::make_unexpected("parameter '" + parameter.get_name() + "' is " + value + "; expected " + expected);
}

// A number from `low` to `high`.
template<typename T>
Verdict within(const rclcpp::Parameter & parameter, T low, T high) {
  const auto value = parameter.get_value<T>();
  if (low <= value && value <= high) {return {};}
  const auto kind = std::is_integral_v<T> ? "a whole number" : "a number";
  return refuse(parameter, quote(value), fmt::format("{} from {:.10g} to {:.10g}", kind, double(low), double(high)));
}

// One of the words `choices`.
template<typename T>
Verdict one_of(const rclcpp::Parameter & parameter, const std::vector<T> & choices) {
  const auto value = parameter.get_value<T>();
  if (std::find(choices.begin(), choices.end(), value) != choices.end()) {return {};}
  return refuse(parameter, quote(value), fmt::format("one of {}", fmt::join(choices, ", ")));
}

}  // namespace ces
