// The settings in the node's parameters, which generate_parameter_library declares from parameters.yaml.
#pragma once

#include <rclcpp_lifecycle/lifecycle_node.hpp>

#include "from_python.hpp"
#include "model/flat_file.hpp"
#include "node/validators.hpp"

namespace ces {

using Node = rclcpp_lifecycle::LifecycleNode;

// A signal: where it is, and how it becomes a value in SI units; or its constant value.
struct SignalSettings {
  std::string name, topic, type, field;
  double scale = 1.0, offset = 0.0;
  double delay_s = 0.0;  // by how much later than measured the numbers are stamped
  std::optional<double> constant = std::nullopt;
};

// Declare `current.constant`, which may be not set, unlike those in the table; `ros2 param dump` then writes `null`.
// Raises UserError.
inline void declare_constant(Node & node) {
  const auto overrides = node.get_node_parameters_interface()->get_parameter_overrides();
  const auto given = overrides.find("current.constant");
  const bool is_null = given != overrides.end() && given->second == rclcpp::ParameterValue("null");
  rcl_interfaces::msg::ParameterDescriptor descriptor;
  descriptor.description = "current: known value in SI units instead of a topic";
  descriptor.dynamic_typing = true;
  const auto value = node.declare_parameter("current.constant", rclcpp::ParameterValue(), descriptor, is_null);
  if (value.get_type() == rclcpp::PARAMETER_NOT_SET) {return;}
  if (value.get_type() != rclcpp::PARAMETER_DOUBLE) {
    throw UserError(
      "Wrong parameter type, parameter {current.constant} is of type {double}, setting it to {" +
      rclcpp::to_string(value.get_type()) + "} is not allowed.");
  }
  const auto verdict = within<double>({"current.constant", value}, -LARGEST, LARGEST);
  if (!verdict) {throw UserError(verdict.error());}
}

// Warn in one line of the parameters that were set and are not known here; both nodes can read one file.
inline void warn_of_unknown(Node & node) {
  std::vector<std::string> unknown;
  for (const auto & [name, value] : node.get_node_parameters_interface()->get_parameter_overrides()) {
    const auto group = name.substr(0, name.find('.'));
    const bool is_python = std::count(std::begin(PYTHON_ONLY), std::end(PYTHON_ONLY), group);
    if (group != "qos_overrides" && !is_python && !node.has_parameter(name)) {unknown.push_back(quote(name));}
  }
  if (unknown.empty()) {return;}
  RCLCPP_WARN(node.get_logger(), "parameters unknown and ignored: %s", join(unknown, ", ").c_str());
}

// The path in the parameter `model`; ~ is the home. Raises UserError unless it is absolute: the node's working folder
// is not that of who sets the parameter.
inline std::string find_model_path(const std::string & text) {
  const char * home = std::getenv("HOME");
  const auto path = home && text.compare(0, 2, "~/") == 0 ? home + text.substr(1) : text;
  if (!path.empty() && path.front() == '/') {return path;}
  throw UserError(
    "parameter 'model' " + (text.empty() ? "is not set" : "is " + quote(text)) +
    "; expected the absolute path of a flat model file: /path/model.ces");
}

inline void check_texts(const SignalSettings & signal, const std::string & where) {
  const std::pair<const char *, const std::string &> texts[] = {
    {"topic", signal.topic}, {"type", signal.type}, {"field", signal.field}};
  for (const auto & [key, text] : texts) {
    if (text.empty()) {throw UserError(where + ": '" + key + "' is missing; set topic, type and field");}
    const auto is_bad = [](char c) {return static_cast<unsigned char>(c) < 0x20 || c == 0x7F;};
    if (text.size() > 255 || std::any_of(text.begin(), text.end(), is_bad)) {
      throw UserError(
        where + ": " + key + " is '" + text.substr(0, 60) + "'; expected at most 255 printable characters");
    }
  }
}

// The settings of a signal; nothing for a motion that is not measured. Raises UserError.
inline std::optional<SignalSettings> read_signal(const Node & node, const std::string & name) {
  if (rclcpp::Parameter constant; name == "current" && node.get_parameter("current.constant", constant)) {
    return SignalSettings{name, "", "", "", 1.0, 0.0, 0.0, constant.as_double()};
  }
  const auto text = [&](const char * key) {return node.get_parameter(name + "." + key).as_string();};
  const auto number = [&](const char * key) {return node.get_parameter(name + "." + key).as_double();};
  const SignalSettings signal{
    name, text("topic"), text("type"), text("field"), number("scale"), number("offset"), number("delay")};
  const bool is_motion = name == MOTIONS[SPEED] || name == MOTIONS[ACCELERATION];
  if (is_motion && (signal.topic + signal.type + signal.field).empty()) {return std::nullopt;}
  const auto where = "parameters: signal '" + name + "'";
  check_texts(signal, where);
  if (signal.scale == 0.0) {throw UserError(where + ": scale is 0; expected the factor from the logged unit to SI");}
  return signal;
}

// The joint's name in the estimates: as set, or that in a field such as position[rear_damper].
inline std::string find_joint(const std::string & name, const std::string & field) {
  const auto open = field.find('['), close = field.find(']');
  if (!name.empty() || open == std::string::npos || close == std::string::npos) {return name.empty() ? "damper" : name;}
  const auto element = field.substr(open + 1, close - open - 1);
  const bool is_index = element.find_first_not_of("0123456789 ") == std::string::npos;
  return is_index ? "damper" : element;
}

}  // namespace ces
