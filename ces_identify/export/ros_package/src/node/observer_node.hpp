// The observer node: piston position and valve current in, estimated damping force out on ~/estimate, and with a
// model that has a delay on ~/estimate_delayed.
//
// The position samples drive it. A timer checks for silence and updates the status on /diagnostics, which names the
// reason for each withheld force. The node resumes by itself. All its callbacks are in one mutually exclusive group,
// /clock included.
#pragma once

#include <diagnostic_updater/diagnostic_updater.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include "core/damper.hpp"
#include "health/health.hpp"
#include "node/inputs.hpp"
#include "node/parameters.hpp"

namespace ces
{

// Publishes a joint's estimates on `topic`, and the bounds of their bands on `topic`_band; reliable unless overridden.
// Each message is filled again and again, so that nothing is allocated here. With intra-process communication rclcpp
// hands each subscriber in the process a copy of its own.
class EstimateOutput
{
public:
  EstimateOutput(rclcpp::Node & node, const std::string & joint, const std::string & topic);

  // Publish an estimate, with its band if the half-width is finite.
  void publish(const Estimate & estimate, const std::string & frame);

private:
  using JointState = sensor_msgs::msg::JointState;

  JointState message_, band_;
  rclcpp::Publisher<JointState>::SharedPtr publisher_, band_publisher_;
};

class ObserverNode : public rclcpp::Node
{
public:
  // Raises UserError for a wrong parameter.
  explicit ObserverNode(const rclcpp::NodeOptions & options);

private:
  void subscribe();
  void on_estimate(Nanoseconds stamp, const std::string & frame, std::optional<double> force_N);
  void on_time_jump(const std::string & what);
  void on_error(const std::string & what) noexcept;
  void on_failure(const std::string & what) noexcept;

  // Run a step; count its failure.
  template<typename Step>
  void guard(const Step & step) noexcept
  {
    try {
      step();
    } catch (const std::exception & error) {
      on_error(error.what());
    }
  }

  void apply_live_parameters();
  void watch();
  void report_change();
  void publish_status();
  void write_status(diagnostic_updater::DiagnosticStatusWrapper & status);
  std::string find_detail();
  std::string describe_topic(const SignalSettings & signal);

  Parameters parameters_;
  std::string joint_;
  SignalSettings position_, current_, motion_;
  Damper damper_;
  Health health_;
  Intake intake_;
  NodeClock clock_;
  EstimateOutput estimate_;
  std::optional<EstimateOutput> late_;
  diagnostic_updater::Updater updater_;
  Inputs inputs_;
  Process process_;
  Reason reported_reason_ = Reason::SILENT, logged_reason_ = Reason::SILENT;
  std::uint64_t watched_samples_ = 0;
  Nanoseconds quiet_ = 0, watched_ = 0, rolled_ = 0, reported_ = 0, logged_ = 0;  // by the steady clock; 0: not yet
  bool is_pending_ = false;
  std::uint64_t jumps_ = 0, failures_ = 0, reported_failures_ = 0;
  std::string jump_ = "none", failure_ = "none";
  OnSetParametersCallbackHandle::SharedPtr on_set_;
  PostSetParametersCallbackHandle::SharedPtr post_set_;
  rclcpp::TimerBase::SharedPtr timer_;
};

// Build the node and run it; returns the exit status: 0 after a signal, 2 with one FATAL line if it cannot be built.
int run_observer(int argc, char ** argv);

}  // namespace ces
