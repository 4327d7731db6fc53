// The observer node: piston position and valve current in, estimated damping force out on ~/estimate.
//
// The position samples drive it. A timer checks for silence and publishes /diagnostics, which name the reason for
// each withheld force. The node resumes by itself. All its callbacks are in one mutually exclusive group, /clock
// included.
#ifndef NODE__OBSERVER_NODE_HPP_
#define NODE__OBSERVER_NODE_HPP_

#include <string>
#include <vector>

#include <rclcpp/node.hpp>

#include "core/damper.hpp"
#include "core/intake.hpp"
#include "health/health.hpp"
#include "node/diagnostics_output.hpp"
#include "node/estimate_output.hpp"
#include "node/input_subscriptions.hpp"
#include "node/node_clock.hpp"
#include "node/parameters.hpp"
#include "process/process_watch.hpp"

namespace ces
{

class ObserverNode : public rclcpp::Node, private EstimateSink
{
public:
  // Raises UserError for a wrong parameter.
  explicit ObserverNode(const rclcpp::NodeOptions & options);

  // What is to run the callbacks of a node on its own: "auto", "single" or "events".
  const std::string & executor_choice() const {return settings_.executor;}

private:
  void subscribe();
  bool subscribe_signal(const SignalSettings & signal, Deliver deliver, OnError on_unreadable);

  void on_force(Nanoseconds stamp, const std::string & frame, double force_N) override;
  void on_processed() override {report_change();}
  void on_time_jump(const std::string & what);
  void on_error(const std::string & what) noexcept;
  void on_failure(const std::string & what) noexcept;
  void roll(Nanoseconds elapsed);

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

  void apply_live_settings();
  void watch();
  void report_change();
  void publish_status();
  std::string find_detail();
  std::string describe_topic(const SignalSettings & signal);

  Settings settings_;
  Damper damper_;
  Health health_;
  Intake intake_;
  NodeClock clock_;
  EstimateOutput estimate_;
  BandOutput band_;
  DiagnosticsOutput diagnostics_;
  InputSubscriptions inputs_;
  ProcessWatch process_;
  LoadMeter load_;
  Reason reported_reason_ = Reason::SILENT;
  std::uint64_t watched_samples_ = 0;
  Nanoseconds quiet_ = 0, watched_ = 0, rolled_ = 0, reported_ = 0;
  bool is_pending_ = false;
  std::uint64_t jumps_ = 0, failures_ = 0, reported_failures_ = 0;
  std::string jump_ = "none", failure_ = "none";
  OnSetParametersCallbackHandle::SharedPtr on_set_;
  PostSetParametersCallbackHandle::SharedPtr post_set_;
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace ces

#endif  // NODE__OBSERVER_NODE_HPP_
