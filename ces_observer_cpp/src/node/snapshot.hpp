// Asks a running `ros2 bag record --snapshot-mode` to write its last seconds, without waiting for its answer.
#pragma once

#include <rosbag2_interfaces/srv/snapshot.hpp>
#include <std_srvs/srv/trigger.hpp>

#include "core/clocks.hpp"
#include "node/settings.hpp"

namespace ces {

// Offers ~/snapshot for the recorder's service `name`; without a name it does nothing.
class Snapshot {
public:
  Snapshot(Node & node, const std::string & name)
  : node_(node) {
    using std_srvs::srv::Trigger;
    if (name.empty()) {return;}
    *state_ = "none taken";
    client_ = node.create_client<Recorder>(name);
    service_ = node.create_service<Trigger>(
      "~/snapshot", [this, name, alive = std::weak_ptr(state_)](
        const std::shared_ptr<Trigger::Request>, std::shared_ptr<Trigger::Response> response) {
        if (alive.expired()) {return;}  // the node was cleaned up after the request had come
        if (since_ == 0) {begin();}
        response->success = true;
        response->message = name + " is being asked; the diagnostics have its answer";
      });
  }

  // Look after a snapshot that is being taken; call it now and then.
  void watch() {
    if (since_ == 0) {return;}
    const auto waited = read_clock(CLOCK_MONOTONIC) - since_;
    if (!is_sent_ && client_->service_is_ready()) {send();}
    if (!is_sent_ && waited > FIND) {
      end("not taken: no recorder in snapshot mode; start 'ros2 bag record --snapshot-mode' for the topics to keep");
    } else if (waited > ANSWER) {
      client_->prune_pending_requests();
      end("not taken: no answer within 20 s");
    }
  }

  // How the last snapshot went.
  const std::string & state() const {return *state_;}

private:
  using Recorder = rosbag2_interfaces::srv::Snapshot;

  static constexpr Nanoseconds FIND = 5 * SECOND, ANSWER = 20 * SECOND;

  void begin() {
    since_ = read_clock(CLOCK_MONOTONIC);
    is_sent_ = false;
    *state_ = "being taken";
    watch();
  }

  void send() {
    is_sent_ = true;
    client_->async_send_request(
      std::make_shared<Recorder::Request>(),
      [this, alive = std::weak_ptr(state_)](rclcpp::Client<Recorder>::SharedFuture answer) {
        if (alive.expired()) {return;}
        const bool is_taken = answer.get()->success;
        end(is_taken ? "taken: the recorder has written its last seconds" : "not taken: the recorder refused");
      });
  }

  void end(const std::string & state) {
    since_ = 0;
    is_sent_ = false;
    *state_ = state;
    RCLCPP_INFO(node_.get_logger(), "snapshot %s", state.c_str());
  }

  Node & node_;
  std::shared_ptr<std::string> state_ = std::make_shared<std::string>("off");
  rclcpp::Client<Recorder>::SharedPtr client_;
  rclcpp::ServiceBase::SharedPtr service_;
  Nanoseconds since_ = 0;  // by the steady clock; 0: none is being taken
  bool is_sent_ = false;
};

}  // namespace ces
