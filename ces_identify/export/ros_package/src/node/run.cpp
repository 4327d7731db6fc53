#include "node/run.hpp"

#include <chrono>
#include <memory>
#include <string>
#include <thread>

#include <rclcpp/executors.hpp>
#include <rclcpp/experimental/executors/events_executor/events_executor.hpp>
#include <rclcpp/rclcpp.hpp>

#include "node/observer_node.hpp"

namespace ces
{
namespace
{

constexpr int USER_ERROR = 2;
constexpr std::chrono::milliseconds PAUSE{1};  // a lasting error must not take the whole processor

std::unique_ptr<rclcpp::Executor> make_executor(const std::string & choice)
{
  if (choice == "single") {return std::make_unique<rclcpp::executors::SingleThreadedExecutor>();}
  return std::make_unique<rclcpp::experimental::executors::EventsExecutor>();
}

std::string find_first_line(const std::string & text) {return text.substr(0, text.find('\n'));}

// Spin until the context is shut down; an error in rclcpp itself is logged, and its executor spun again.
void spin_on(rclcpp::Executor & executor)
{
  while (rclcpp::ok()) {
    try {
      executor.spin();
      return;
    } catch (const std::exception & error) {
      RCLCPP_ERROR(rclcpp::get_logger("observer"), "unexpected error; the node runs on: %s", error.what());
      std::this_thread::sleep_for(PAUSE);
    }
  }
}

}  // namespace

int run_observer(int argc, char ** argv)
{
  int status = 0;
  try {
    rclcpp::init(argc, argv);
    const auto node = std::make_shared<ObserverNode>(rclcpp::NodeOptions());
    const auto executor = make_executor(node->executor_choice());
    executor->add_node(node);
    spin_on(*executor);
    executor->remove_node(node);
  } catch (const std::exception & error) {
    RCLCPP_FATAL(rclcpp::get_logger("observer"), "%s", find_first_line(error.what()).c_str());
    status = USER_ERROR;
  }
  if (rclcpp::ok()) {rclcpp::shutdown();}
  return status;
}

}  // namespace ces
