#include "node/run.hpp"

#include <memory>
#include <string>

#include <rclcpp/executors.hpp>
#include <rclcpp/experimental/executors/events_executor/events_executor.hpp>
#include <rclcpp/rclcpp.hpp>

#include "node/observer_node.hpp"

namespace ces
{
namespace
{

constexpr int USER_ERROR = 2;

std::unique_ptr<rclcpp::Executor> make_executor(const std::string & choice)
{
  if (choice == "single") {return std::make_unique<rclcpp::executors::SingleThreadedExecutor>();}
  return std::make_unique<rclcpp::experimental::executors::EventsExecutor>();
}

std::string find_first_line(const std::string & text) {return text.substr(0, text.find('\n'));}

}  // namespace

int run_observer(int argc, char ** argv)
{
  int status = 0;
  try {
    rclcpp::init(argc, argv);
    const auto node = std::make_shared<ObserverNode>(rclcpp::NodeOptions());
    const auto executor = make_executor(node->executor_choice());
    executor->add_node(node);
    executor->spin();
    executor->remove_node(node);
  } catch (const std::exception & error) {
    RCLCPP_FATAL(rclcpp::get_logger("observer"), "%s", find_first_line(error.what()).c_str());
    status = USER_ERROR;
  }
  if (rclcpp::ok()) {rclcpp::shutdown();}
  return status;
}

}  // namespace ces
