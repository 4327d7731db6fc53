// A controller manager with mock hardware and simulated time, in which `follower` takes the force of `damper_force`.
//
//   control_loop URDF SCRIPT [--ros-args ...]
//
// SCRIPT has lines of stamp [ns], position and current, played at 1 kHz; before and after each block the controllers
// are inactive. Prints for each update of the follower: the part played, stamp, position, current and force; then the
// allocations and the time [us] of that cycle's updates of all controllers, and the time of `damper_force` alone.
#include <atomic>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <sstream>

#include <controller_interface/controller_interface.hpp>
#include <controller_manager/controller_manager.hpp>
#include <rclcpp/executors.hpp>
#include <realtime_tools/realtime_helpers.hpp>

extern "C" void * __libc_malloc(std::size_t size);
thread_local long allocations = 0;
extern "C" void * malloc(std::size_t size)
{
  ++allocations;
  return __libc_malloc(size);
}

using controller_interface::CallbackReturn;
using controller_interface::return_type;
using Clock = std::chrono::steady_clock;

struct Row
{
  long long stamp;
  double position, current, force;
};

class Follower : public controller_interface::ControllerInterface
{
public:
  CallbackReturn on_init() override {return CallbackReturn::SUCCESS;}

  controller_interface::InterfaceConfiguration command_interface_configuration() const override
  {
    return {controller_interface::interface_configuration_type::INDIVIDUAL, {"damper/position", "damper/current"}};
  }

  controller_interface::InterfaceConfiguration state_interface_configuration() const override
  {
    return {
      controller_interface::interface_configuration_type::INDIVIDUAL,
      {"damper/position", "damper/current", "damper_force/damper/damping_force"}};
  }

  return_type update(const rclcpp::Time & time, const rclcpp::Duration &) override
  {
    const auto read = [this](std::size_t i) {return state_interfaces_[i].get_optional().value();};
    row = {time.nanoseconds(), read(0), read(1), read(2)};
    is_new = true;
    const bool is_set = command_interfaces_[0].set_value(position) && command_interfaces_[1].set_value(current);
    return is_set ? return_type::OK : return_type::ERROR;
  }

  Row row{};
  bool is_new = false;
  double position = 0.0, current = 0.0;  // to command next
};

int main(int argc, char ** argv)
{
  const auto slurp = [](const char * path) {return (std::stringstream() << std::ifstream(path).rdbuf()).str();};
  std::vector<std::vector<Row>> parts(1);
  std::istringstream script(slurp(argv[2]));
  for (std::string line; std::getline(script, line); ) {
    Row row{};
    if (line.empty()) {
      parts.emplace_back();
    } else if (std::sscanf(line.c_str(), "%lld %lf %lf", &row.stamp, &row.position, &row.current) == 3) {
      parts.back().push_back(row);
    }
  }

  rclcpp::init(argc, argv);
  auto executor = std::make_shared<rclcpp::executors::MultiThreadedExecutor>();
  auto options = controller_manager::get_cm_node_options();
  options.arguments({argv + 3, argv + argc});
  options.append_parameter_override("use_sim_time", true);
  auto manager = std::make_shared<controller_manager::ControllerManager>(
    executor, slurp(argv[1]), true, "controller_manager", "", options);
  auto * clock = manager->get_clock()->get_clock_handle();
  if (rcl_enable_ros_time_override(clock) != RCL_RET_OK) {return 1;}
  auto follower = std::make_shared<Follower>();
  if (!manager->load_controller("damper_force") || !manager->add_controller(follower, "follower", "Follower")) {return 1;}
  const auto own_times = manager->get_loaded_controllers().front().execution_time_statistics;
  executor->add_node(manager);
  std::thread spinning([&executor] {executor->spin();});

  std::atomic<std::size_t> part{0};
  std::atomic<bool> is_playing{false}, ended{false};
  std::thread loop(
    [&] {
      realtime_tools::configure_sched_fifo(50);
      const rclcpp::Duration period(std::chrono::milliseconds(1));
      std::vector<std::string> lines;
      auto next = Clock::now();
      long long stamp = parts[0][0].stamp - 1'000'000'000;
      for (std::size_t i = 0; !ended; ) {
        stamp += 1'000'000;
        if (is_playing && i < parts[part].size()) {
          const auto & row = parts[part][i++];
          stamp = row.stamp;
          follower->position = row.position;
          follower->current = row.current;
        } else if (is_playing) {
          is_playing = false;
          i = 0;
        }
        {
          const std::lock_guard<std::mutex> lock(manager->get_clock()->get_clock_mutex());
          if (rcl_set_ros_time_override(clock, stamp) != RCL_RET_OK) {return;}
        }
        const auto now = manager->get_trigger_clock()->now();
        manager->read(now, period);
        const auto before = allocations;
        const auto began = Clock::now();
        manager->update(now, period);
        const std::chrono::duration<double, std::micro> took = Clock::now() - began;
        const auto allocated = allocations - before;
        manager->write(now, period);
        if (std::exchange(follower->is_new, false)) {
          char text[200];
          const auto & row = follower->row;
          std::snprintf(
            text, sizeof text, "%zu %lld %.17g %.17g %.17g %ld %.3f %.3f", part.load(), row.stamp, row.position,
            row.current, row.force, allocated, took.count(),
            own_times->get_current_measurement_const_ptr());
          lines.emplace_back(text);
        }
        std::this_thread::sleep_until(next += std::chrono::milliseconds(1));
      }
      for (const auto & line : lines) {std::puts(line.c_str());}
    });

  const std::vector<std::string> both{"damper_force", "follower"};
  const auto timeout = rclcpp::Duration::from_seconds(20.0);
  bool is_well = true;
  for (const auto & name : both) {is_well = is_well && manager->configure_controller(name) == return_type::OK;}
  for (; is_well && part < parts.size(); ++part) {
    is_well = manager->switch_controller(both, {}, 2, true, timeout) == return_type::OK;
    for (is_playing = is_well; is_playing; ) {std::this_thread::sleep_for(std::chrono::milliseconds(1));}
    is_well = is_well && manager->switch_controller({}, both, 2, true, timeout) == return_type::OK;
  }
  ended = true;
  loop.join();
  executor->cancel();
  spinning.join();
  rclcpp::shutdown();
  return is_well ? 0 : 1;
}
