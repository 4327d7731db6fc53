#include "node/observer_node.hpp"

#include <algorithm>
#include <chrono>
#include <set>

namespace ces
{
namespace
{

constexpr std::chrono::milliseconds WATCH_PERIOD{100};
constexpr Nanoseconds WATCH = 100'000'000;  // minimum time between two diagnostics
constexpr Nanoseconds DIAGNOSTICS = SECOND;
constexpr double MIN_SILENCE_S = 0.2;

SignalHold make_current(const SignalSettings & signal)
{
  return signal.constant ? SignalHold::constant(*signal.constant) : SignalHold::measured(Model::MAX_CURRENT_AGE_S);
}

SignalHold make_motion(const SignalSettings & signal)
{
  return signal.is_set() ? SignalHold::measured(Model::MAX_GAP_S) : SignalHold::constant(0.0);
}

}  // namespace

ObserverNode::ObserverNode(const rclcpp::NodeOptions & options)
: Node("observer", rclcpp::NodeOptions(options).use_clock_thread(false)),
  settings_(declare_settings(*this)),
  damper_(make_current(settings_.current), make_motion(settings_.motion), 0.0),
  health_(damper_),
  intake_(damper_, *this),
  clock_(*this, [this](const std::string & what) {on_time_jump(what);}),
  estimate_(*this, "~/estimate", settings_.joint),
  band_(*this, "~/estimate_band", settings_.joint),
  diagnostics_(*this, settings_.joint),
  inputs_(*this, clock_, settings_.input_depth, [this](const std::string & what) {on_failure(what);}),
  process_(settings_.real_time)
{
  apply_live_settings();
  on_set_ = add_on_set_parameters_callback(
    [](const std::vector<rclcpp::Parameter> & parameters) {
      rcl_interfaces::msg::SetParametersResult result;
      result.reason = find_refusal(parameters);
      result.successful = result.reason.empty();
      return result;
    });
  post_set_ = add_post_set_parameters_callback(
    [this](const std::vector<rclcpp::Parameter> &) {guard([this] {apply_live_settings();});});
  watched_ = rolled_ = reported_ = read_clock(CLOCK_MONOTONIC);
  timer_ = create_wall_timer(WATCH_PERIOD, [this] {guard([this] {watch();});});
  subscribe();
  RCLCPP_INFO(get_logger(), "%s: %s, compiled in, SHA-256 %.12s", settings_.joint.c_str(), Model::SIZE, Model::DIGEST);
}

// Subscribe, to the position last: what else its message carries holds for it.
void ObserverNode::subscribe()
{
  if (!settings_.current.constant) {
    const bool stamped = subscribe_signal(
      settings_.current,
      [this](Nanoseconds stamp, double current_A, const std::string &, Nanoseconds now) {
        health_.current.take(stamp, now);
        intake_.take_current(stamp, current_A, now);
      },
      [this](const std::string & error) {damper_.count_unreadable_current(error);});
    health_.current.set_topic(stamped, inputs_.losses_of(settings_.current));
  }
  if (settings_.motion.is_set()) {
    subscribe_signal(
      settings_.motion,
      [this](Nanoseconds stamp, double value, const std::string &, Nanoseconds now) {
        intake_.take_motion(stamp, value, now);
      },
      [this](const std::string & error) {damper_.count_unreadable_motion(error);});
  }
  const bool stamped = subscribe_signal(
    settings_.position,
    [this](Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now) {
      health_.position.take(stamp, now);
      health_.stillness.take(stamp, position_m);
      intake_.take_position(stamp, position_m, frame, now);
    },
    [this](const std::string & error) {damper_.count_unreadable_position(error);});
  health_.position.set_topic(stamped, inputs_.losses_of(settings_.position));
}

bool ObserverNode::subscribe_signal(const SignalSettings & signal, Deliver deliver, OnError on_unreadable)
{
  const bool stamped = inputs_.subscribe(signal, std::move(deliver), std::move(on_unreadable));
  if (!stamped) {
    RCLCPP_WARN(
      get_logger(), "signal '%s': %s has no header; samples are stamped with their arrival", signal.name.c_str(),
      signal.type.c_str());
  }
  return stamped;
}

void ObserverNode::on_force(Nanoseconds stamp, const std::string & frame, double force_N)
{
  estimate_.publish(stamp, frame, damper_.position(), damper_.speed(), force_N);
  health_.latency.take(clock_.now() - stamp);
  if (const auto width = damper_.half_width()) {band_.publish(stamp, frame, force_N - *width, force_N + *width);}
}

// Restart after a time jump.
void ObserverNode::on_time_jump(const std::string & what)
{
  guard([this, &what] {  // rcl calls this in the middle of setting its clock
      ++jumps_;
      jump_ = what;
      RCLCPP_WARN(get_logger(), "%s: the estimates restart", what.c_str());
      inputs_.reset();
      intake_.reset(clock_.now());
      report_change();
    });
}

// Count an unexpected error for the next diagnostics; no message may end the node.
void ObserverNode::on_error(const std::string & what) noexcept
{
  ++failures_;
  try {
    failure_ = what;
  } catch (...) {
    failure_.clear();
  }
}

// Begin anew after a failure in a sample's way, which may have left the estimator half changed.
void ObserverNode::on_failure(const std::string & what) noexcept
{
  on_error(what);
  guard([this] {
      intake_.restart();
      report_change();
    });
}

void ObserverNode::apply_live_settings()
{
  const auto settings = read_live_settings(*this);
  damper_.set_max_age(settings.max_age_s);
  intake_.set_wait(settings.wait_for_current_s);
  health_.stillness.set_warn(settings.still_warn_s);
}

void ObserverNode::watch()
{
  const auto now = read_clock(CLOCK_MONOTONIC), elapsed = now - watched_;
  watched_ = now;
  clock_.watch();
  intake_.release(clock_.now());
  quiet_ = damper_.tally().samples == watched_samples_ ? quiet_ + elapsed : 0;
  watched_samples_ = damper_.tally().samples;
  if (quiet_ >= to_ns(std::max(MIN_SILENCE_S, Model::MAX_GAP_S))) {
    damper_.report_silence();
    report_change();
  }
  if (now - rolled_ >= DIAGNOSTICS) {
    roll(now - rolled_);
    rolled_ = now;
    publish_status();
  } else if (is_pending_) {
    publish_status();
  }
}

void ObserverNode::roll(Nanoseconds elapsed)
{
  const auto warning = process_.update();
  if (!warning.empty()) {RCLCPP_WARN(get_logger(), "%s", warning.c_str());}
  health_.roll(to_s(elapsed), load_.measure());
}

// Report a new reason at once, or by the watch timer if the last report was just now.
void ObserverNode::report_change()
{
  if (damper_.reason() == reported_reason_) {return;}
  reported_reason_ = damper_.reason();
  health_.note_change(clock_.now());
  is_pending_ = true;
  if (read_clock(CLOCK_MONOTONIC) - reported_ >= WATCH) {publish_status();}
}

void ObserverNode::publish_status()
{
  reported_ = read_clock(CLOCK_MONOTONIC);
  is_pending_ = false;
  auto status = health_.report(find_detail());
  status.add_remark(process_.find_remark());
  if (failures_ > reported_failures_) {
    status.add_remark(std::to_string(failures_) + " unexpected errors, the last: " + failure_);
  }
  status.values.emplace_back("model", "compiled in");
  status.values.emplace_back("model sha256", Model::DIGEST);
  status.values.insert(status.values.end(), process_.values().begin(), process_.values().end());
  status.values.emplace_back("jumps of time", std::to_string(jumps_) + ", the last: " + jump_);
  status.values.emplace_back("unexpected errors", std::to_string(failures_) + ", the last: " + failure_);
  diagnostics_.publish(damper_.reason(), status);
  reported_failures_ = failures_;
}

// Details of the damper's reason, including the state of a silent topic.
std::string ObserverNode::find_detail()
{
  const auto detail = damper_.explain();
  if (!detail.empty()) {return detail;}
  switch (damper_.reason()) {
    case Reason::SILENT: return describe_topic(settings_.position);
    case Reason::NO_CURRENT: return settings_.current.constant ? "" : describe_topic(settings_.current);
    case Reason::NO_MOTION: return describe_topic(settings_.motion);
    default: return "";
  }
}

std::string ObserverNode::describe_topic(const SignalSettings & signal)
{
  const auto topic = get_node_topics_interface()->resolve_topic_name(signal.topic);
  std::set<std::string> types;
  for (const auto & publisher : get_publishers_info_by_topic(topic)) {types.insert(publisher.topic_type());}
  if (types.empty()) {return "nothing publishes " + topic;}
  if (types.count(signal.type)) {return topic + " has a publisher that is silent";}
  std::string names;
  for (const auto & type : types) {names += (names.empty() ? "" : ", ") + type;}
  return topic + " carries " + names + "; " + signal.name + ".type is " + signal.type;
}

}  // namespace ces
