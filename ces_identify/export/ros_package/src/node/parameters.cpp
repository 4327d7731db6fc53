#include "node/parameters.hpp"

#include <algorithm>
#include <array>
#include <set>

#include "node/parameter_values.hpp"
#include "node/user_error.hpp"

namespace ces
{
namespace
{

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
const std::set<std::string> OF_ROS{"use_sim_time", "start_type_description_service"};

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
    node, "executor", "auto",
    "what runs the callbacks of the program `observer`: 'events' (auto) is rclcpp's EventsExecutor, 'single' its "
    "SingleThreadedExecutor");
  if (settings.executor != "auto" && settings.executor != "single" && settings.executor != "events") {
    throw UserError("parameter 'executor' is '" + settings.executor + "'; expected one of auto, events, single");
  }
  settings.input_depth = static_cast<std::size_t>(declare_whole(node, INPUT_DEPTH));
  settings.real_time = declare_real_time(node);
  settings.joint = declare_text(
    node, "name", "", "joint name in the estimate; empty: the one in position.field, else 'damper'");
  settings.position = declare_position(node);
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
