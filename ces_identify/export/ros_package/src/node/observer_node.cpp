#include "node/observer_node.hpp"

#include <rclcpp/experimental/executors/events_executor/events_executor.hpp>

namespace ces
{
namespace
{

constexpr std::size_t OUTPUT_DEPTH = 1000;  // as of the inputs: a burst after a stall is published completely
constexpr std::chrono::milliseconds WATCH_PERIOD{100};
constexpr Nanoseconds WATCH = 100'000'000;  // minimum time between two diagnostics
constexpr Nanoseconds DIAGNOSTICS = SECOND;
constexpr Nanoseconds LOG = SECOND;  // minimum time between two lines, against floods by a flickering reason
constexpr double MIN_SILENCE_S = 0.2;
constexpr double NEVER_S = 1e6;
constexpr int USER_ERROR = 2;
constexpr std::chrono::milliseconds PAUSE{1};  // a lasting error must not take the whole processor

}  // namespace

EstimateOutput::EstimateOutput(rclcpp::Node & node, const std::string & joint, const std::string & topic)
{
  rclcpp::PublisherOptions options;
  options.qos_overriding_options = rclcpp::QosOverridingOptions::with_default_policies();
  publisher_ = node.create_publisher<JointState>(topic, rclcpp::QoS(OUTPUT_DEPTH), options);
  band_publisher_ = node.create_publisher<JointState>(topic + "_band", rclcpp::QoS(OUTPUT_DEPTH), options);
  message_.name = {joint};
  message_.position = message_.velocity = message_.effort = {0.0};
  band_.name = {joint + "_lower", joint + "_upper"};
  band_.effort = {0.0, 0.0};
}

void EstimateOutput::publish(const Estimate & estimate, const std::string & frame)
{
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
}

ObserverNode::ObserverNode(const rclcpp::NodeOptions & options)
: Node(
    "observer", rclcpp::NodeOptions(options).use_clock_thread(false).append_parameter_override(
      "diagnostic_updater.use_fqn", true)),
  parameters_(*this),
  joint_(parameters_.joint()),
  position_(parameters_.position()), current_(parameters_.current()), motion_(parameters_.motion()),
  damper_(SignalHold(Model::MAX_CURRENT_AGE_S, current_.constant), SignalHold(Model::MAX_GAP_S, motion_.constant)),
  health_(damper_),
  intake_(damper_, [this](auto stamp, const auto & frame, auto force_N) {on_estimate(stamp, frame, force_N);}),
  clock_(*this, [this](const std::string & what) {on_time_jump(what);}),
  estimate_(*this, joint_, "~/estimate"),
  updater_(this, NEVER_S),  // its timer stands still with simulated time: `watch` updates it
  inputs_(
    *this, clock_, static_cast<std::size_t>(parameters_.get<std::int64_t>("input_depth")),
    [this](const std::string & what) {on_failure(what);}),
  process_(parameters_.real_time())
{
  if (Model::DELAY_TICKS) {late_.emplace(*this, joint_, "~/estimate_delayed");}
  updater_.setHardwareID(joint_);
  updater_.add(joint_, [this](auto & status) {write_status(status);});
  apply_live_parameters();
  on_set_ = add_on_set_parameters_callback(
    [](const std::vector<rclcpp::Parameter> & parameters) {
      rcl_interfaces::msg::SetParametersResult result;
      result.reason = Parameters::find_refusal(parameters);
      result.successful = result.reason.empty();
      return result;
    });
  post_set_ = add_post_set_parameters_callback(
    [this](const std::vector<rclcpp::Parameter> &) {guard([this] {apply_live_parameters();});});
  watched_ = rolled_ = reported_ = read_clock(CLOCK_MONOTONIC);
  timer_ = create_wall_timer(WATCH_PERIOD, [this] {guard([this] {watch();});});
  subscribe();
  RCLCPP_INFO(get_logger(), "%s: %s, compiled in, SHA-256 %.12s", joint_.c_str(), Model::SIZE, Model::DIGEST);
}

// Subscribe, to the position last: what else its message carries holds for it.
void ObserverNode::subscribe()
{
  const auto count_unreadable = [this](Input input) {
      return [this, input](const std::string & error) {damper_.count_unreadable(input, error);};
    };
  if (!current_.constant) {
    const auto take = [this](Nanoseconds stamp, double current_A, const std::string &, Nanoseconds now) {
        health_.current.take(stamp, now);
        intake_.take_current(stamp, current_A, now);
      };
    inputs_.subscribe(current_, take, count_unreadable(CURRENT), &health_.current);
  }
  if (!motion_.constant) {
    const auto take = [this](Nanoseconds stamp, double value, const std::string &, Nanoseconds now) {
        intake_.take_motion(stamp, value, now);
      };
    inputs_.subscribe(motion_, take, count_unreadable(MOTION), nullptr);
  }
  const auto take = [this](Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now) {
      health_.position.take(stamp, now);
      health_.stillness.take(stamp, position_m);
      intake_.take_position(stamp, position_m, frame, now);
    };
  inputs_.subscribe(position_, take, count_unreadable(POSITION), &health_.position);
}

void ObserverNode::on_estimate(Nanoseconds stamp, const std::string & frame, std::optional<double> force_N)
{
  if (force_N) {
    estimate_.publish({stamp, damper_.position(), damper_.speed(), *force_N, damper_.half_width()}, frame);
    health_.latency.take(clock_.now() - stamp);
  }
  for (const auto & one : damper_.late()) {
    late_->publish(one, frame);
    if (!Model::HAS_NOW) {health_.latency.take(clock_.now() - one.stamp);}
  }
  report_change();
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

void ObserverNode::apply_live_parameters()
{
  damper_.set_max_age(parameters_.number("max_age_s"));
  intake_.set_wait(parameters_.number("wait_for_current_s"));
  health_.stillness.set_warn(parameters_.number("still_warn_s"));
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
    if (const auto warning = process_.roll(); !warning.empty()) {RCLCPP_WARN(get_logger(), "%s", warning.c_str());}
    health_.roll(to_s(now - rolled_));
    rolled_ = now;
    publish_status();
  } else if (is_pending_) {
    publish_status();
  }
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
  updater_.force_update();
}

// Write the status that the updater publishes, and log a new reason.
void ObserverNode::write_status(diagnostic_updater::DiagnosticStatusWrapper & status)
{
  using diagnostic_msgs::msg::DiagnosticStatus;
  health_.report(status, find_detail());
  const auto failures = std::to_string(failures_) + " unexpected errors, the last: " + failure_;
  for (const auto & remark : {process_.find_remark(), failures_ > reported_failures_ ? failures : ""}) {
    if (remark.empty()) {continue;}
    status.level = std::max<std::uint8_t>(status.level, DiagnosticStatus::WARN);
    status.message += "; " + remark;
  }
  reported_failures_ = failures_;
  status.add("model", "compiled in");
  status.add("model sha256", Model::DIGEST);
  status.addf("delay_s", "%g", Model::DELAY_S);
  process_.add_values(status);
  status.add("jumps of time", std::to_string(jumps_) + ", the last: " + jump_);
  status.add("unexpected errors", std::to_string(failures_) + ", the last: " + failure_);
  const auto now = read_clock(CLOCK_MONOTONIC);
  if (logged_ != 0 && (damper_.reason() == logged_reason_ || now - logged_ < LOG)) {return;}
  logged_ = now;
  logged_reason_ = damper_.reason();
  if (status.level == DiagnosticStatus::OK) {
    RCLCPP_INFO(get_logger(), "%s: %s", joint_.c_str(), status.message.c_str());
  } else {
    RCLCPP_WARN(get_logger(), "%s: %s", joint_.c_str(), status.message.c_str());
  }
}

// Details of the damper's reason, including the state of a silent topic.
std::string ObserverNode::find_detail()
{
  const auto detail = damper_.explain();
  if (!detail.empty()) {return detail;}
  switch (damper_.reason()) {
    case Reason::SILENT: return describe_topic(position_);
    case Reason::NO_CURRENT: return current_.constant ? "" : describe_topic(current_);
    case Reason::NO_MOTION: return describe_topic(motion_);
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
  return topic + " carries " + join(types, ", ") + "; " + signal.name + ".type is " + signal.type;
}

int run_observer(int argc, char ** argv)
{
  int status = 0;
  try {
    rclcpp::init(argc, argv);
    const auto node = std::make_shared<ObserverNode>(rclcpp::NodeOptions());
    std::unique_ptr<rclcpp::Executor> executor;
    if (node->get_parameter("executor").as_string() == "single") {
      executor = std::make_unique<rclcpp::executors::SingleThreadedExecutor>();
    } else {
      executor = std::make_unique<rclcpp::experimental::executors::EventsExecutor>();
    }
    executor->add_node(node);
    for (bool is_over = false; rclcpp::ok() && !is_over; ) {
      try {
        executor->spin();
        is_over = true;
      } catch (const std::exception & error) {  // in rclcpp itself
        RCLCPP_ERROR(rclcpp::get_logger("observer"), "unexpected error; the node runs on: %s", error.what());
        std::this_thread::sleep_for(PAUSE);
      }
    }
    executor->remove_node(node);
  } catch (const std::exception & error) {
    const std::string text = error.what();
    RCLCPP_FATAL(rclcpp::get_logger("observer"), "%s", text.substr(0, text.find('\n')).c_str());
    status = USER_ERROR;
  }
  if (rclcpp::ok()) {rclcpp::shutdown();}
  return status;
}

}  // namespace ces
