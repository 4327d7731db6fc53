// The topics of estimates and bands: numbers in, sensor_msgs/JointState out.
#ifndef NODE__ESTIMATE_OUTPUT_HPP_
#define NODE__ESTIMATE_OUTPUT_HPP_

#include <string>

#include <rclcpp/node.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include "core/numbers.hpp"

namespace ces
{

// Publisher of joint states; reliable unless overridden. One message is filled again and again, so that nothing is
// allocated here. With intra-process communication rclcpp hands each subscriber in the process a copy of its own.
class JointStateOutput
{
public:
  JointStateOutput(rclcpp::Node & node, const std::string & topic)
  {
    rclcpp::PublisherOptions options;
    options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
    publisher_ = node.create_publisher<sensor_msgs::msg::JointState>(topic, rclcpp::QoS(OUTPUT_DEPTH), options);
  }

protected:
  void publish(Nanoseconds stamp, const std::string & frame)
  {
    const auto seconds = stamp / SECOND - (stamp % SECOND < 0);
    message_.header.stamp.sec = static_cast<std::int32_t>(seconds);
    message_.header.stamp.nanosec = static_cast<std::uint32_t>(stamp - seconds * SECOND);
    message_.header.frame_id = frame;
    publisher_->publish(message_);
  }

  sensor_msgs::msg::JointState message_;

private:
  static constexpr std::size_t OUTPUT_DEPTH = 1000;  // as of the inputs: a burst after a stall is published completely

  rclcpp::Publisher<sensor_msgs::msg::JointState>::SharedPtr publisher_;
};

// Estimates of the joint `name`.
class EstimateOutput : private JointStateOutput
{
public:
  EstimateOutput(rclcpp::Node & node, const std::string & topic, const std::string & name)
  : JointStateOutput(node, topic)
  {
    message_.name = {name};
    message_.position = message_.velocity = message_.effort = {0.0};
  }

  void publish(Nanoseconds stamp, const std::string & frame, double position_m, double speed_m_s, double force_N)
  {
    message_.position[0] = position_m;
    message_.velocity[0] = speed_m_s;
    message_.effort[0] = force_N;
    JointStateOutput::publish(stamp, frame);
  }
};

// Bounds of the joint `name`, as joints NAME_lower and NAME_upper.
class BandOutput : private JointStateOutput
{
public:
  BandOutput(rclcpp::Node & node, const std::string & topic, const std::string & name)
  : JointStateOutput(node, topic)
  {
    message_.name = {name + "_lower", name + "_upper"};
    message_.effort = {0.0, 0.0};
  }

  void publish(Nanoseconds stamp, const std::string & frame, double lower_N, double upper_N)
  {
    message_.effort[0] = lower_N;
    message_.effort[1] = upper_N;
    JointStateOutput::publish(stamp, frame);
  }
};

}  // namespace ces

#endif  // NODE__ESTIMATE_OUTPUT_HPP_
