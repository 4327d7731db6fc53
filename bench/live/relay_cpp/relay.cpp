// An empty relay, the minimum cost of a C++ node: it publishes each JointState that it receives unchanged.
// Usage: relay single|events --ros-args -r __ns:=/NAMESPACE

#include <string>

#include <rclcpp/experimental/executors/events_executor/events_executor.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

using sensor_msgs::msg::JointState;

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  const auto arguments = rclcpp::remove_ros_arguments(argc, argv);
  auto node = std::make_shared<rclcpp::Node>("relay");
  auto publisher = node->create_publisher<JointState>("~/estimate", 10);
  auto subscription = node->create_subscription<JointState>(
    "joint_states", rclcpp::QoS(100).best_effort(),
    [publisher](JointState::UniquePtr message) {publisher->publish(std::move(message));});
  if (arguments.size() > 1 && arguments[1] == "events") {
    rclcpp::experimental::executors::EventsExecutor executor;
    executor.add_node(node);
    executor.spin();
  } else {
    rclcpp::spin(node);
  }
  rclcpp::shutdown();
}
