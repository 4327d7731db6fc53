// An empty relay, the least that a C++ node costs: it publishes each JointState that it receives unchanged.
// Usage: relay --ros-args -r __ns:=/NAMESPACE

#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

using sensor_msgs::msg::JointState;

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  auto node = std::make_shared<rclcpp::Node>("relay");
  auto publisher = node->create_publisher<JointState>("~/estimate", 1000);
  auto subscription = node->create_subscription<JointState>(
    "joint_states", rclcpp::QoS(5000).best_effort(),
    [publisher](JointState::UniquePtr message) {publisher->publish(std::move(message));});
  rclcpp::spin(node);
  rclcpp::shutdown();
}
