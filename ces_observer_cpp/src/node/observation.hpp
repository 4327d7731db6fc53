// What the node has while it is configured: the damper's observer between its topics.
//
// The position samples drive it. Estimates are published while the node is active; inactive, it stays warm.
#pragma once

#include <lifecycle_msgs/msg/state.hpp>

#include "core/damper.hpp"
#include "health/health.hpp"
#include "node/inputs.hpp"
#include "node/model_changes.hpp"

namespace ces {

// Publishes a joint's estimates on `topic`, and the bounds of their bands on `topic`_band; reliable unless overridden.
// Each message is filled again and again, so that nothing is allocated here. With intra-process communication rclcpp
// hands each subscriber in the process a copy of its own.
class EstimateOutput {
public:
  EstimateOutput(Node & node, const std::string & joint, const std::string & topic) {
    rclcpp::PublisherOptions options;
    options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
    publisher_ = node.create_publisher<JointState>(topic, rclcpp::QoS(DEPTH), options);
    band_publisher_ = node.create_publisher<JointState>(topic + "_band", rclcpp::QoS(DEPTH), options);
    message_.name = {joint};
    message_.position = message_.velocity = message_.effort = {0.0};
    band_.name = {joint + "_lower", joint + "_upper"};
    band_.effort = {0.0, 0.0};
  }

  void activate() {
    publisher_->on_activate();
    band_publisher_->on_activate();
  }

  // Publish an estimate, with its band if the half-width is finite; returns whether the node is active.
  bool publish(const Estimate & estimate, const std::string & frame) {
    if (!publisher_->is_activated()) {return false;}
    const auto seconds = estimate.stamp / SECOND - (estimate.stamp % SECOND < 0);
    message_.header.stamp.sec = static_cast<std::int32_t>(seconds);
    message_.header.stamp.nanosec = static_cast<std::uint32_t>(estimate.stamp - seconds * SECOND);
    message_.header.frame_id = frame;
    message_.position[0] = estimate.position;
    message_.velocity[0] = estimate.speed;
    message_.effort[0] = estimate.force;
    publisher_->publish(message_);
    if (std::isfinite(estimate.half_width)) {
      band_.header = message_.header;
      band_.effort[0] = estimate.force - estimate.half_width;
      band_.effort[1] = estimate.force + estimate.half_width;
      band_publisher_->publish(band_);
    }
    return true;
  }

private:
  using JointState = sensor_msgs::msg::JointState;

  static constexpr std::size_t DEPTH = 1000;  // a burst after a stall is published completely

  JointState message_, band_;
  rclcpp_lifecycle::LifecyclePublisher<JointState>::SharedPtr publisher_, band_publisher_;
};

class Observation {
public:
  // `on_change` is called when the damper may have another reason, `on_failure` with an unexpected error of a sample.
  // Raises UserError for a wrong parameter.
  Observation(
    Node & node, const NodeClock & clock, const std::string & joint, std::function<void()> on_change, OnText on_failure)
  : node_(node), clock_(clock), joint_(joint), on_change_(std::move(on_change)), on_failure_(std::move(on_failure)),
    position_(*read_signal(node, "position")), current_(*read_signal(node, "current")),
    motions_{std::nullopt, read_signal(node, MOTIONS[SPEED]), read_signal(node, MOTIONS[ACCELERATION])},
    damper(load_model(node), SignalHold(current_.constant), make_holds()),
    health(damper), changes(node, damper, [this] {offer_late();}),
    intake_(damper, [this](auto stamp, const auto & frame, auto force_N) {on_estimate(stamp, frame, force_N);}),
    now_(node, joint, "~/estimate"),
    inputs_(
      node, clock, static_cast<std::size_t>(node.get_parameter("input_depth").as_int()),
      [this](const std::string & what) {fail(what);}, [this](const std::string & topic) {on_silence(topic);}) {
    offer_late();
    subscribe();
  }

  void set_live(double max_age_s, double wait_for_current_s, double still_warn_s) {
    damper.set_max_age(max_age_s);
    intake_.set_wait(wait_for_current_s);
    health.stillness.set_warn(still_warn_s);
  }

  // Restart after a time jump.
  void reset(const std::string & what) {
    health.note_jump(what);
    inputs_.reset();
    intake_.reset(clock_.now());
  }

  // Do what is due `elapsed` after the last call.
  void watch(Nanoseconds elapsed) {
    intake_.release(clock_.now());
    changes.watch();
    quiet_ = damper.tally().samples == watched_samples_ ? quiet_ + elapsed : 0;
    watched_samples_ = damper.tally().samples;
    if (quiet_ >= to_ns(std::max(MIN_SILENCE_S, damper.model().max_gap_s))) {
      damper.report_silence();
      on_change_();
    }
  }

  // For how long each sample has failed at `now` of the steady clock.
  Nanoseconds failing(Nanoseconds now) {
    if (failures_ == watched_failures_) {failing_since_ = 0;}
    watched_failures_ = failures_;
    return failing_since_ == 0 ? 0 : now - failing_since_;
  }

  std::string find_mismatch() const {return inputs_.find_mismatch();}

  // Details of the damper's reason, including the state of a silent topic.
  std::string find_detail() const {
    const auto detail = damper.explain();
    if (!detail.empty()) {return detail;}
    switch (damper.reason()) {
      case Reason::SILENT: return describe_topic(position_);
      case Reason::NO_CURRENT: return current_.constant ? "" : describe_topic(current_);
      case Reason::NO_MOTION: return describe_topic(*motions_[damper.model().motion]);
      default: return "";
    }
  }

private:
  static constexpr double MIN_SILENCE_S = 0.2;

  Node & node_;
  const NodeClock & clock_;
  std::string joint_;
  std::function<void()> on_change_;
  OnText on_failure_;
  SignalSettings position_, current_;
  std::array<std::optional<SignalSettings>, 3> motions_;  // by Motion

public:
  Damper damper;
  Health health;
  ModelChanges changes;

private:
  Damper::Motions make_holds() const {
    Damper::Motions holds;
    for (const auto motion : {SPEED, ACCELERATION}) {if (motions_[motion]) {holds[motion].emplace();}}
    return holds;
  }

  // Offer the topics of the delayed estimates while a model with a delay runs or is about to.
  void offer_late() {
    const auto * next = damper.next_model();
    if (!damper.model().delay_ticks && !(next && next->delay_ticks)) {
      late_.reset();
    } else if (!late_) {
      late_.emplace(node_, joint_, "~/estimate_delayed");
      if (node_.get_current_state().id() == lifecycle_msgs::msg::State::PRIMARY_STATE_ACTIVE) {late_->activate();}
    }
  }

  // Subscribe, to the position last: what else its message carries holds for it.
  void subscribe() {
    const auto count_unreadable = [this](Input input) {
        return [this, input](const std::string & error) {damper.count_unreadable(input, error);};
      };
    if (!current_.constant) {
      const auto take = [this](Nanoseconds stamp, double current_A, const std::string &, Nanoseconds now) {
          health.current.take(stamp, now);
          intake_.take_current(stamp, current_A, now);
        };
      inputs_.subscribe(current_, take, count_unreadable(CURRENT), &health.current);
    }
    for (const auto motion : {SPEED, ACCELERATION}) {
      const auto take = [this, motion](Nanoseconds stamp, double value, const std::string &, Nanoseconds now) {
          intake_.take_motion(motion, stamp, value, now);
        };
      if (motions_[motion]) {inputs_.subscribe(*motions_[motion], take, count_unreadable(MOTION), nullptr);}
    }
    const auto take = [this](Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now) {
        health.position.take(stamp, now);
        health.stillness.take(stamp, position_m);
        intake_.take_position(stamp, position_m, frame, now);
      };
    inputs_.subscribe(position_, take, count_unreadable(POSITION), &health.position);
  }

  void on_estimate(Nanoseconds stamp, const std::string & frame, std::optional<double> force_N) {
    if (force_N) {
      const Estimate now{stamp, damper.position(), damper.speed(), *force_N, damper.half_width()};
      if (now_.publish(now, frame)) {health.latency.take(clock_.now() - stamp);}
    }
    for (const auto & one : damper.late()) {
      if (late_ && late_->publish(one, frame)) {health.latency.take(clock_.now() - one.stamp);}
    }
    failing_since_ = 0;
    on_change_();
  }

  // Withhold at once, where the middleware says that no position comes: `watch` notices it later.
  void on_silence(const std::string & topic) {
    if (topic != node_.get_node_topics_interface()->resolve_topic_name(position_.topic)) {return;}
    damper.report_silence();
    on_change_();
  }

  // Begin anew after a failure in a sample's way, which may have left the estimator half changed.
  void fail(const std::string & what) noexcept {
    ++failures_;
    if (failing_since_ == 0) {failing_since_ = read_clock(CLOCK_MONOTONIC);}
    on_failure_(what);
    try {
      intake_.restart();
      on_change_();
    } catch (const std::exception & error) {
      on_failure_(error.what());
    }
  }

  std::string describe_topic(const SignalSettings & signal) const {
    const auto topic = node_.get_node_topics_interface()->resolve_topic_name(signal.topic);
    const auto types = find_types(node_, topic);
    if (types.empty()) {return "nothing publishes " + topic;}
    if (types.count(signal.type)) {return topic + " has a publisher that is silent";}
    return topic + " carries " + join(types, ", ") + "; " + signal.name + ".type is " + signal.type;
  }

  Intake intake_;
  EstimateOutput now_;
  std::optional<EstimateOutput> late_;
  Inputs inputs_;
  std::uint64_t watched_samples_ = 0, failures_ = 0, watched_failures_ = 0;
  Nanoseconds quiet_ = 0, failing_since_ = 0;  // the latter by the steady clock; 0: the last sample has not failed
};

}  // namespace ces
