#include "node/parameters.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "core/numbers.hpp"
#include "model/estimator.hpp"
#include "model/signals.hpp"
#include "node/user_error.hpp"

namespace ces
{
namespace
{

struct NumberSpec {const char * name; double value, lowest, highest; const char * meaning;};

struct WholeSpec {const char * name; int64_t value, lowest, highest; const char * meaning;};

constexpr std::array<NumberSpec, 3> LIVE{{
  {"max_age_s", 0.5, 0.0, 3600.0,
    "largest difference between a position's stamp and the clock at which its force is published [s]; 0: any"},
  {"wait_for_current_s", 0.0, 0.0, 10.0,
    "longest time for which a position waits until a current stamped no earlier is known [s]; 0: no waiting"},
  {"still_warn_s", 1.0, 0.0, 3600.0,
    "time without any change of position after which a warning is given: vehicle at rest, or stuck sensor [s]; "
    "0: never"}}};
constexpr WholeSpec INPUT_DEPTH{
  "input_depth", 5000, 1, 100'000,
  "messages that wait in the queue of each input while the node stalls; at least the highest rate times the longest "
  "stall. Full queues lose the oldest"};
constexpr WholeSpec PRIORITY{
  "realtime_priority", 0, 0, MAX_PRIORITY,
  "priority of the node under SCHED_FIFO, that of its DDS threads is one higher; 0: ordinary scheduling"};
constexpr double LARGEST = 1e30;  // scale, offset or constant: beyond any unit, and far from overflow
constexpr std::size_t LONGEST = 255;  // characters of a topic, type or field path
const std::set<std::string> OF_ROS{"use_sim_time", "start_type_description_service"};

rcl_interfaces::msg::ParameterDescriptor describe(const std::string & meaning, bool is_live = false)
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

std::vector<std::size_t> declare_processors(rclcpp::Node & node)
{
  const auto value = node.declare_parameter(
    "cpu_affinity", rclcpp::ParameterValue(std::vector<int64_t>{-1}),
    describe("processors that the node may use, such as [2, 3]; [-1]: all"));
  const bool is_list = value.get_type() == rclcpp::PARAMETER_INTEGER_ARRAY;
  const auto numbers = is_list ? value.get<std::vector<int64_t>>() : std::vector<int64_t>{};
  if (numbers == std::vector<int64_t>{-1}) {return {};}
  const auto is_processor = [](int64_t number) {return 0 <= number && number < static_cast<int64_t>(MAX_PROCESSORS);};
  if (numbers.empty() || !std::all_of(numbers.begin(), numbers.end(), is_processor)) {
    throw UserError("parameter 'cpu_affinity' is " + quote(value) + "; expected numbers of processors such as [2, 3]");
  }
  return {numbers.begin(), numbers.end()};
}

RealTimeOptions declare_real_time(rclcpp::Node & node)
{
  RealTimeOptions options;
  options.priority = static_cast<int>(declare_whole(node, PRIORITY));
  options.processors = declare_processors(node);
  const auto lock = node.declare_parameter(
    "lock_memory", rclcpp::ParameterValue(false), describe("keep the node's memory from being swapped out"));
  if (lock.get_type() != rclcpp::PARAMETER_BOOL) {
    throw UserError("parameter 'lock_memory' is " + quote(lock) + "; expected a truth value (true or false)");
  }
  options.lock_memory = lock.get<bool>();
  return options;
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

double declare_factor(rclcpp::Node & node, const std::string & name, double value)
{
  const auto read = node.declare_parameter(
    name, rclcpp::ParameterValue(value), describe("value in SI units = scale * number + offset"));
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
  signal.scale = declare_factor(node, prefix + "scale", signal.scale);
  signal.offset = declare_factor(node, prefix + "offset", signal.offset);
  if (signal.scale == 0.0) {
    throw UserError("signal '" + signal.name + "': scale is 0; expected the factor from the logged unit to SI");
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
  if (node.get_node_parameters_interface()->get_parameter_overrides().count("current.topic")) {current.constant.reset();}
  return current;
}

SignalSettings declare_current(rclcpp::Node & node)
{
  auto current = declare_signal(node, find_default_current(node));
  const auto value = node.declare_parameter(
    "current.constant", current.constant ? rclcpp::ParameterValue(*current.constant) : rclcpp::ParameterValue(),
    describe("current: known value in SI units instead of a topic"));
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

// The element's name in a field such as position[rear_damper]; empty without one.
std::string find_joint(const std::string & field)
{
  const auto open = field.find('['), close = field.find(']');
  if (open == std::string::npos || close == std::string::npos) {return "";}
  const auto element = field.substr(open + 1, close - open - 1);
  const bool is_index = element.find_first_not_of("0123456789 ") == std::string::npos;
  return is_index ? "" : element;
}

// Warn in one line of the parameters that were set and are not known.
void warn_of_unknown(rclcpp::Node & node)
{
  std::string names;
  for (const auto & [name, value] : node.get_node_parameters_interface()->get_parameter_overrides()) {
    const bool known = node.has_parameter(name) || OF_ROS.count(name) || name.rfind("qos_overrides.", 0) == 0 ||
      name.rfind("force.", 0) == 0;
    if (!known) {names += (names.empty() ? "'" : ", '") + name + "'";}
  }
  if (!names.empty()) {
    RCLCPP_WARN(
      node.get_logger(), "parameters unknown and ignored: %s; the model is compiled into this node", names.c_str());
  }
}

}  // namespace

Settings declare_settings(rclcpp::Node & node)
{
  for (const auto & spec : LIVE) {
    check_number(
      spec, node.declare_parameter(spec.name, rclcpp::ParameterValue(spec.value), describe(spec.meaning, true)));
  }
  Settings settings;
  settings.executor = declare_text(
    node, "executor", "auto", "what runs the callbacks of the program `observer`: 'events' (auto) is rclcpp's EventsExecutor, 'single' its "
    "SingleThreadedExecutor");
  if (settings.executor != "auto" && settings.executor != "single" && settings.executor != "events") {
    throw UserError("parameter 'executor' is '" + settings.executor + "'; expected one of auto, events, single");
  }
  settings.input_depth = static_cast<std::size_t>(declare_whole(node, INPUT_DEPTH));
  settings.real_time = declare_real_time(node);
  settings.joint = declare_text(
    node, "name", "", "joint name in the estimate; empty: the one in position.field, else 'damper'");
  settings.position = declare_signal(node, POSITION);
  check_signal(settings.position);
  settings.current = declare_current(node);
  settings.motion = declare_motion(node);
  if (settings.joint.empty()) {settings.joint = find_joint(settings.position.field);}
  if (settings.joint.empty()) {settings.joint = "damper";}
  warn_of_unknown(node);
  return settings;
}

LiveSettings read_live_settings(const rclcpp::Node & node)
{
  const auto read = [&node](const NumberSpec & spec) {
      return check_number(spec, node.get_parameter(spec.name).get_parameter_value());
    };
  return {read(LIVE[0]), read(LIVE[1]), read(LIVE[2])};
}

std::string find_refusal(const std::vector<rclcpp::Parameter> & parameters)
{
  for (const auto & parameter : parameters) {
    for (const auto & spec : LIVE) {
      if (parameter.get_name() != spec.name) {continue;}
      try {
        check_number(spec, parameter.get_parameter_value());
      } catch (const UserError & error) {
        return error.what();
      }
    }
  }
  return "";
}

}  // namespace ces
