// Changes the model of the running node, by its parameter `model` or its service `reload_model`.
//
// A file is read and checked at once, in milliseconds; one that cannot be used is refused with the reason, and the old
// model runs on. Its stability was proved where it was written. The outcome of each request is latched on
// ~/model_status, by its number.
#pragma once

#include <diagnostic_msgs/msg/diagnostic_status.hpp>
#include <diagnostic_updater/diagnostic_status_wrapper.hpp>
#include <std_srvs/srv/trigger.hpp>

#include "core/damper.hpp"
#include "node/settings.hpp"

namespace ces {

// The model in the file that the parameter `model` names. Raises UserError.
inline ModelPtr load_model(const Node & node, const std::string & text) {
  return read_model(find_model_path(text), node.get_parameter("allow_uncertified").as_bool());
}

inline ModelPtr load_model(const Node & node) {return load_model(node, node.get_parameter("model").as_string());}

class ModelChanges {
public:
  // `on_load` is called when another model warms up or has taken over.
  ModelChanges(Node & node, Damper & damper, std::function<void()> on_load)
  : node_(node), damper_(damper), on_load_(std::move(on_load)), running_(damper.running()),
    status_(rclcpp::create_publisher<Status>(node, "~/model_status", rclcpp::QoS(1).transient_local())) {
    service_ = node.create_service<Trigger>(
      "~/reload_model", [this, alive = std::weak_ptr(alive_)](
        const std::shared_ptr<Trigger::Request>, std::shared_ptr<Trigger::Response> response) {
        if (!alive.expired()) {reload(*response);}
      }, rclcpp::ServicesQoS().keep_last(MAX_REQUESTS));
  }

  // Let a model take over when it has warmed up; returns what to answer. Raises UserError if the damper cannot run it.
  std::string adopt(const ModelPtr & model) {
    watch();
    damper_.load(model);
    if (accepted_) {report(*accepted_, "overtaken", "by " + model->path);}
    accepted_ = Request{++requests_, model};
    on_load_();
    report(*accepted_, "accepted", format_number("takes over when warmed up, after %g s of samples", model->warm_up_s));
    RCLCPP_INFO(node_.get_logger(), "%s", state_.c_str());
    return "request " + std::to_string(requests_) + ": " + state_ + "; the outcome comes on " +
           status_->get_topic_name();
  }

  // Report a model that has taken over since the last call.
  void watch() {
    if (damper_.running() == running_) {return;}
    running_ = damper_.running();
    report(*accepted_, "has taken over", "");
    accepted_.reset();
    on_load_();
  }

  void add_values(diagnostic_updater::DiagnosticStatusWrapper & status) const {
    status.add("model", running_->path);
    status.add("model sha256", running_->digest);
    status.addf("delay_s", "%g", running_->delay_s);
    status.add("computed by", rounds_ ? "compiled core" : "compiled core, which rounds otherwise than Python's");
    status.add("last change of the model", state_);
    status.add("models refused", refused_);
  }

private:
  using Status = diagnostic_msgs::msg::DiagnosticStatus;
  using Trigger = std_srvs::srv::Trigger;

  static constexpr std::size_t MAX_REQUESTS = 1000;  // that wait for their answer

  struct Request {
    std::uint64_t number;
    ModelPtr model;  // null: it could not be read
  };

  // Read the file in the parameter again.
  void reload(Trigger::Response & response) {
    try {
      response.message = adopt(load_model(node_));
      response.success = true;
    } catch (const UserError & error) {
      ++refused_;
      response.message = error.what();
      report({++requests_, nullptr}, "refused", error.what());
      RCLCPP_ERROR_THROTTLE(node_.get_logger(), steady_, 1000, "%s", state_.c_str());
    }
  }

  // Keep the state of a request for diagnostics, and latch it.
  void report(const Request & request, const std::string & state, const std::string & detail) {
    const auto path = request.model ? request.model->path : node_.get_parameter("model").as_string();
    state_ = request.model ? path + ": " + state + (detail.empty() ? "" : "; " + detail) :
      "refused, the old model runs on: " + detail;
    diagnostic_updater::DiagnosticStatusWrapper status;
    status.name = node_.get_fully_qualified_name() + (": request " + std::to_string(request.number));
    status.summary(request.model ? Status::OK : Status::ERROR, state_);
    status.add("request", request.number);
    status.add("state", state);
    status.add("model", path);
    if (request.model) {
      status.add("model sha256", request.model->digest);
      status.addf("delay_s", "%g", request.model->delay_s);
    }
    status_->publish(static_cast<const Status &>(status));
  }

  Node & node_;
  Damper & damper_;
  std::function<void()> on_load_;
  ModelPtr running_;
  rclcpp::Publisher<Status>::SharedPtr status_;
  rclcpp::ServiceBase::SharedPtr service_;
  std::shared_ptr<bool> alive_ = std::make_shared<bool>();  // a request may be answered after the node was cleaned up
  rclcpp::Clock steady_{RCL_STEADY_TIME};
  std::optional<Request> accepted_;
  bool rounds_ = rounds_like_python();
  std::uint64_t requests_ = 0, refused_ = 0;
  std::string state_ = "none";
};

}  // namespace ces
