#include "node/signal_parameters.hpp"

#include <algorithm>
#include <cmath>

#include "core/numbers.hpp"
#include "model/estimator.hpp"
#include "model/signals.hpp"
#include "node/parameter_values.hpp"
#include "node/user_error.hpp"

namespace ces
{
namespace
{

constexpr double LARGEST = 1e30;  // scale, offset or constant: beyond any unit, and far from overflow
constexpr std::size_t LONGEST = 255;  // characters of a topic, type or field path

const char SCALING[] = "value in SI units = scale * number + offset";
const char DELAY[] = "[s] by how much later than measured the numbers are stamped; stamps are moved back by it";

double declare_finite(rclcpp::Node & node, const std::string & name, double value, const char * meaning)
{
  const auto read = node.declare_parameter(name, rclcpp::ParameterValue(value), describe(meaning));
  const auto number = find_number(read);
  if (!number || !(std::fabs(*number) <= LARGEST)) {
    throw UserError("parameter '" + name + "' is " + quote(read) + "; expected a finite number, at most 1e+30");
  }
  return *number;
}

void check_text(const SignalSettings & signal, const char * key, const std::string & text)
{
  const auto where = "signal '" + signal.name + "': ";
  if (text.empty()) {throw UserError(where + "'" + key + "' is missing; set topic, type and field");}
  const auto is_bad = [](char c) {return static_cast<unsigned char>(c) < 0x20 || c == 0x7F;};
  if (text.size() > LONGEST || std::any_of(text.begin(), text.end(), is_bad)) {
    throw UserError(where + key + " is '" + text.substr(0, 60) + "'; expected at most 255 printable characters");
  }
}

SignalSettings declare_signal(rclcpp::Node & node, SignalSettings signal)
{
  const auto prefix = signal.name + ".";
  signal.topic = declare_text(
    node, prefix + "topic", signal.topic, signal.name + ": topic; a relative name is resolved in the node's namespace");
  signal.type = declare_text(
    node, prefix + "type", signal.type, signal.name + ": message type, such as sensor_msgs/msg/JointState");
  signal.field = declare_text(
    node, prefix + "field", signal.field,
    signal.name + ": path to the number in the message, such as data, wrench.force.z or position[rear_damper]");
  signal.scale = declare_finite(node, prefix + "scale", signal.scale, SCALING);
  signal.offset = declare_finite(node, prefix + "offset", signal.offset, SCALING);
  signal.delay_s = declare_finite(node, prefix + "delay", signal.delay_s, DELAY);
  if (signal.scale == 0.0) {
    throw UserError("signal '" + signal.name + "': scale is 0; expected the factor from the logged unit to SI");
  }
  if (std::fabs(signal.delay_s) > MAX_DELAY_S) {
    throw UserError(
      "signal '" + signal.name + "': delay is " + format_number("%g", signal.delay_s) + " s; expected at most " +
      format_number("%g", MAX_DELAY_S) + " s (it is in seconds)");
  }
  return signal;
}

void check_signal(const SignalSettings & signal)
{
  check_text(signal, "topic", signal.topic);
  check_text(signal, "type", signal.type);
  check_text(signal, "field", signal.field);
}

// The current at export, unless a topic replaces its constant value.
SignalSettings find_default_current(rclcpp::Node & node)
{
  auto current = CURRENT;
  const auto & overrides = node.get_node_parameters_interface()->get_parameter_overrides();
  if (overrides.count("current.topic")) {current.constant.reset();}
  return current;
}

// What `ros2 param dump` writes for a parameter that is not set is read as a text.
bool is_null(rclcpp::Node & node, const std::string & name)
{
  const auto & overrides = node.get_node_parameters_interface()->get_parameter_overrides();
  const auto given = overrides.find(name);
  return given != overrides.end() && given->second == rclcpp::ParameterValue("null");
}

}  // namespace

SignalSettings declare_position(rclcpp::Node & node)
{
  auto position = declare_signal(node, POSITION);
  check_signal(position);
  return position;
}

SignalSettings declare_current(rclcpp::Node & node)
{
  auto current = declare_signal(node, find_default_current(node));
  const auto value = node.declare_parameter(
    "current.constant", current.constant ? rclcpp::ParameterValue(*current.constant) : rclcpp::ParameterValue(),
    describe("current: known value in SI units instead of a topic"), is_null(node, "current.constant"));
  current.constant = find_number(value);
  if (value.get_type() != rclcpp::PARAMETER_NOT_SET && !(current.constant && std::fabs(*current.constant) <= LARGEST)) {
    throw UserError("parameter 'current.constant' is " + quote(value) + "; expected a finite number, at most 1e+30");
  }
  if (!current.constant) {check_signal(current);}
  return current;
}

SignalSettings declare_motion(rclcpp::Node & node)
{
  const std::string name = Model::MOTION;
  if (name.empty()) {return {};}
  auto motion = declare_signal(node, MOTION);
  if (motion.topic.empty() || motion.type.empty() || motion.field.empty()) {
    throw UserError(
      "the model needs the signal '" + name + "' (differentiator " + Model::DIFFERENTIATOR + "); set " + name +
      ".topic, " + name + ".type and " + name + ".field");
  }
  check_signal(motion);
  return motion;
}

}  // namespace ces
