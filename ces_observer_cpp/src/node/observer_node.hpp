// The observer node: piston position and valve current in, estimated damping force out on ~/estimate, and with a
// model that has a delay on ~/estimate_delayed.
//
// It is a managed node, which with `autostart` configures and activates itself. A timer checks for silence and updates
// the status on /diagnostics, which names the reason for each withheld force. The node resumes by itself. All its
// callbacks are in one mutually exclusive group, /clock included.
#pragma once

#include <diagnostic_updater/diagnostic_updater.hpp>
#include <ces_observer_cpp/observer_parameters.hpp>

#include "node/bond.hpp"
#include "node/observation.hpp"
#include "node/parameter_services.hpp"

namespace ces {

class ObserverNode : public Node {
public:
  // Raises UserError for a wrong parameter, or if the node is to start itself and cannot.
  explicit ObserverNode(const rclcpp::NodeOptions & options);

private:
  using Transition = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;
  using State = rclcpp_lifecycle::State;

  Transition on_configure(const State &) override;
  Transition on_activate(const State & state) override;
  Transition on_deactivate(const State & state) override;
  Transition on_cleanup(const State &) override;
  Transition on_shutdown(const State & state) override {return on_cleanup(state);}
  Transition on_error(const State & state) override {return on_cleanup(state);}
  void let_go();
  void start();
  void fall();
  void on_time_jump(const std::string & what);
  void on_error(const std::string & what) noexcept;

  // Run a step; count its failure.
  template<typename Step>
  void guard(const Step & step) noexcept {
    try {
      step();
    } catch (const std::exception & error) {
      on_error(error.what());
    }
  }

  void apply(const observer::Params & parameters);
  rcl_interfaces::msg::SetParametersResult check_model(const std::vector<rclcpp::Parameter> & changed);
  std::string load_model();
  void name_tasks();
  void watch();
  void roll(double elapsed_s);
  void watch_failures(Nanoseconds now);
  void report_change();
  void publish_status();
  std::array<Task, 4> make_tasks();
  void collect_values();
  void publish_details();
  void log_reason();

  std::unique_ptr<observer::ParamListener> parameters_;
  std::string joint_;
  ParameterServices services_;
  NodeClock clock_;
  rclcpp::Clock steady_{RCL_STEADY_TIME};
  diagnostic_updater::Updater updater_;
  rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticArray>::SharedPtr details_;
  KernelDrops drops_;
  Bond bond_;
  std::unique_ptr<Observation> made_;  // while it is configured
  ModelPtr loaded_, next_;  // for the parameter that is being set, and for one that was set
  std::array<Task, 4> tasks_;  // of the last report, with all values
  Status values_;
  std::string state_;
  ReasonLog reason_log_;
  Reason reported_reason_ = Reason::SILENT;
  Nanoseconds watched_ = 0, rolled_ = 0, reported_ = 0, next_start_ = 0;  // by the steady clock; 0: not yet
  bool is_pending_ = false, is_starting_ = false, has_fallen_ = false;
  std::uint64_t failures_ = 0, reported_failures_ = 0;
  std::string mistake_, failure_ = "none", mismatch_;
  rclcpp::node_interfaces::OnSetParametersCallbackHandle::SharedPtr model_checks_;
  rclcpp::node_interfaces::PostSetParametersCallbackHandle::SharedPtr model_loads_;
  rclcpp::TimerBase::SharedPtr timer_;
};

// Build the node and run it; returns the exit status: 0 after a signal, 2 with one FATAL line if it cannot be built.
int run_observer(int argc, char ** argv);

}  // namespace ces
