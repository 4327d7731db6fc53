// The node's parameters: declared with their meaning, and checked as the Python observer checks them.
#pragma once

#include <map>
#include <stdexcept>

#include <rclcpp/node.hpp>

#include "core/samples.hpp"
#include "health/process.hpp"
#include "model/estimator.hpp"
#include "model/parameters.hpp"

namespace ces
{

// A mistake of the user, in one line: what is wrong, where, what was expected and what to do.
class UserError : public std::runtime_error
{
  using std::runtime_error::runtime_error;
};

// A signal: where it is, and how it becomes a value in SI units; or its constant value.
struct SignalSettings
{
  std::string name, topic, type, field;
  double scale = 1.0, offset = 0.0;
  double delay_s = 0.0;  // by how much later than measured the numbers are stamped
  std::optional<double> constant;
};

class Parameters
{
public:
  // Declare all parameters, and warn in one line of those that were set and are not known; raises UserError.
  explicit Parameters(rclcpp::Node & node)
  : node_(node)
  {
    for (const auto & spec : PARAMETERS) {
      check(spec, node.declare_parameter(spec.name, spec.value, describe(spec.meaning, spec.is_live)));
    }
    const auto null = overrides().find("current.constant");  // what `ros2 param dump` writes for one that is not set
    const bool is_null = null != overrides().end() && null->second == rclcpp::ParameterValue("null");
    const auto constant = overrides().count("current.topic") ? rclcpp::ParameterValue() : CURRENT_CONSTANT;
    node.declare_parameter(
      "current.constant", constant, describe("current: known value in SI units instead of a topic"), is_null);
    std::vector<std::string> unknown;
    for (const auto & [name, value] : overrides()) {
      const auto group = name.substr(0, name.find('.'));
      if (!node.has_parameter(name) && !OTHERS.count(group)) {unknown.push_back("'" + name + "'");}
    }
    if (!unknown.empty()) {
      RCLCPP_WARN(
        node.get_logger(), "parameters unknown and ignored: %s; the model is compiled into this node",
        join(unknown, ", ").c_str());
    }
  }

  template<typename T>
  T get(const std::string & name) const {return value_of(name).get<T>();}

  double number(const std::string & name) const {return *find_number(value_of(name));}

  RealTimeOptions real_time() const
  {
    RealTimeOptions options;
    options.priority = static_cast<int>(get<std::int64_t>("realtime_priority"));
    options.lock_memory = get<bool>("lock_memory");
    options.processors = get<std::vector<std::int64_t>>("cpu_affinity");
    if (options.processors == std::vector<std::int64_t>{-1}) {options.processors.clear();}
    return options;
  }

  SignalSettings position() const {return signal("position");}

  SignalSettings current() const
  {
    auto current = signal("current", false);
    const auto value = value_of("current.constant");
    current.constant = find_number(value);
    if (value.get_type() != rclcpp::PARAMETER_NOT_SET && !(current.constant && std::isfinite(*current.constant))) {
      throw UserError("parameter 'current.constant' is " + quote(value) + "; expected a finite number");
    }
    if (!current.constant) {check_texts(current);}
    return current;
  }

  // The signal that the model needs beside the position: a constant if it needs none.
  SignalSettings motion() const
  {
    if (*Model::MOTION) {return signal(Model::MOTION);}
    SignalSettings none;
    none.constant = 0.0;
    return none;
  }

  // The joint's name in the estimates: as set, or that in a field such as position[rear_damper].
  std::string joint() const
  {
    const auto name = get<std::string>("name"), field = get<std::string>("position.field");
    const auto open = field.find('['), close = field.find(']');
    if (!name.empty() || open == std::string::npos || close == std::string::npos) {return name.empty() ? "damper" : name;}
    const auto element = field.substr(open + 1, close - open - 1);
    const bool is_index = element.find_first_not_of("0123456789 ") == std::string::npos;
    return is_index ? "damper" : element;
  }

  // Why one of these parameters cannot be set while the node runs; empty if all can.
  static std::string find_refusal(const std::vector<rclcpp::Parameter> & parameters)
  {
    for (const auto & parameter : parameters) {
      for (const auto & spec : PARAMETERS) {
        try {
          if (parameter.get_name() == spec.name) {check(spec, parameter.get_parameter_value());}
        } catch (const UserError & error) {
          return error.what();
        }
      }
    }
    return "";
  }

private:
  static constexpr std::size_t LONGEST = 255;  // characters of a topic, type or field path
  static inline const std::set<std::string> OTHERS{  // ROS's own, and what only the Python node has
    "use_sim_time", "start_type_description_service", "qos_overrides", "diagnostic_updater", "force"};

  static rcl_interfaces::msg::ParameterDescriptor describe(const std::string & meaning, bool is_live = false)
  {
    rcl_interfaces::msg::ParameterDescriptor descriptor;
    descriptor.description = meaning;
    descriptor.read_only = !is_live;
    descriptor.dynamic_typing = true;  // whole numbers are numbers, too
    return descriptor;
  }

  // A value as errors show it.
  static std::string quote(const rclcpp::ParameterValue & value)
  {
    const auto text = rclcpp::to_string(value);
    return value.get_type() == rclcpp::PARAMETER_STRING ? "'" + text + "'" : text;
  }

  // The number, whole or not; nothing for another type.
  static std::optional<double> find_number(const rclcpp::ParameterValue & value)
  {
    if (value.get_type() == rclcpp::PARAMETER_INTEGER) {return static_cast<double>(value.get<std::int64_t>());}
    if (value.get_type() == rclcpp::PARAMETER_DOUBLE) {return value.get<double>();}
    return std::nullopt;
  }

  // Raise UserError unless `value` has the type and the range of the parameter.
  static void check(const ParameterSpec & spec, const rclcpp::ParameterValue & value)
  {
    static const std::map<rclcpp::ParameterType, std::string> EXPECTED{
      {rclcpp::PARAMETER_BOOL, "a truth value (true or false)"}, {rclcpp::PARAMETER_INTEGER, "a whole number"},
      {rclcpp::PARAMETER_DOUBLE, "a number"}, {rclcpp::PARAMETER_STRING, "a string"},
      {rclcpp::PARAMETER_INTEGER_ARRAY, "numbers of processors such as [2, 3]"}};
    const auto type = spec.value.get_type();
    const auto number = find_number(value);
    auto fits = value.get_type() == type || (type == rclcpp::PARAMETER_DOUBLE && number);
    auto expected = EXPECTED.at(type);
    if (fits && number) {
      fits = spec.low <= *number && *number <= spec.high;
      expected = format_number("%g", spec.low) + format_number(" to %g", spec.high);
    } else if (fits && !spec.choices.empty()) {
      fits = std::count(spec.choices.begin(), spec.choices.end(), value.get<std::string>());
      expected = "one of " + join(spec.choices, ", ");
    } else if (fits && type == rclcpp::PARAMETER_INTEGER_ARRAY) {
      const auto & numbers = value.get<std::vector<std::int64_t>>();
      const auto is_processor = [](std::int64_t one) {return 0 <= one && one < CPU_SETSIZE;};
      fits = numbers == spec.value.get<std::vector<std::int64_t>>() ||
        (!numbers.empty() && std::all_of(numbers.begin(), numbers.end(), is_processor));
    }
    if (!fits) {throw UserError("parameter '" + spec.name + "' is " + quote(value) + "; expected " + expected);}
  }

  static void check_texts(const SignalSettings & signal)
  {
    const auto where = "signal '" + signal.name + "': ";
    const std::pair<std::string, std::string> texts[] = {
      {"topic", signal.topic}, {"type", signal.type}, {"field", signal.field}};
    for (const auto & [key, text] : texts) {
      if (text.empty()) {
        const auto why = signal.name == Model::MOTION ? "; the model needs it" : "";
        throw UserError(where + "'" + key + "' is missing" + why + "; set topic, type and field");
      }
      const auto is_bad = [](char c) {return static_cast<unsigned char>(c) < 0x20 || c == 0x7F;};
      if (text.size() > LONGEST || std::any_of(text.begin(), text.end(), is_bad)) {
        throw UserError(where + key + " is '" + text.substr(0, 60) + "'; expected at most 255 printable characters");
      }
    }
  }

  const std::map<std::string, rclcpp::ParameterValue> & overrides() const
  {
    return node_.get_node_parameters_interface()->get_parameter_overrides();
  }

  rclcpp::ParameterValue value_of(const std::string & name) const
  {
    return node_.get_parameter(name).get_parameter_value();
  }

  SignalSettings signal(const std::string & name, bool is_measured = true) const
  {
    SignalSettings signal{
      name, get<std::string>(name + ".topic"), get<std::string>(name + ".type"), get<std::string>(name + ".field"),
      number(name + ".scale"), number(name + ".offset"), number(name + ".delay"), std::nullopt};
    const auto where = "signal '" + name + "': ";
    if (signal.scale == 0.0) {
      throw UserError(where + "scale is 0; expected the factor from the logged unit to SI");
    }
    if (std::fabs(signal.delay_s) > MAX_DELAY_S) {
      throw UserError(
        where + "delay is " + format_number("%g", signal.delay_s) + " s; expected at most " +
        format_number("%g", MAX_DELAY_S) + " s (it is in seconds)");
    }
    if (is_measured) {check_texts(signal);}
    return signal;
  }

  rclcpp::Node & node_;
};

}  // namespace ces
