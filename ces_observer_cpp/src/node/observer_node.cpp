#include "node/observer_node.hpp"

#include <lifecycle_msgs/msg/state.hpp>
#include <rclcpp_components/register_node_macro.hpp>

namespace ces {
namespace {

using States = lifecycle_msgs::msg::State;

constexpr std::chrono::milliseconds WATCH_PERIOD{100};
constexpr Nanoseconds WATCH = 100'000'000;  // minimum time between two diagnostics
constexpr Nanoseconds DIAGNOSTICS = SECOND;
constexpr Nanoseconds FALL = 5 * SECOND;  // of failures at each sample, after which the node leaves the active state
constexpr Nanoseconds RETRY = 5 * SECOND;
constexpr double NEVER_S = 1e6;
constexpr int USER_ERROR = 2;
constexpr std::chrono::milliseconds PAUSE{1};  // a lasting error must not take the whole processor
constexpr std::size_t MAX_LOGGED = 100;  // kinds of errors
constexpr std::array<const char *, 4> TASKS{"health", "frequency", "time stamps", "model"};
const std::array<std::vector<std::string>, TASKS.size()> KEYS{{
  {"reason", "state", "withheld in the last second [%]", "share outside the envelope", "episodes of withholding",
    "last episode", "unexpected errors"},
  {"position: rate [Hz]", "current: rate [Hz]", "dropped", "forces estimated"},
  {"age of the last position on arrival [s]", "latency from stamp to publish, p50 [ms]",
    "latency from stamp to publish, p99 [ms]", "latency from stamp to publish, max [ms]", "jumps of time"},
  {"model sha256", "last change of the model"}}};

// The node's parameters, as their table declares them. Raises UserError with the reason alone.
std::unique_ptr<observer::ParamListener> declare_all(Node & node) {
  try {
    auto listener = std::make_unique<observer::ParamListener>(&node);
    declare_constant(node);
    return listener;
  } catch (const rclcpp::exceptions::InvalidParameterTypeException & error) {
    const std::string text = error.what(), end = "has invalid type: ";
    throw UserError(text.substr(std::min(text.size(), text.find(end) + end.size())));
  } catch (const rclcpp::exceptions::InvalidParameterValueException & error) {
    const std::string text = error.what();
    throw UserError(text.substr(text.find(": ") + 2));
  }
}

}  // namespace

ObserverNode::ObserverNode(const rclcpp::NodeOptions & options)
: Node(
    "observer", rclcpp::NodeOptions(options).use_clock_thread(false).start_parameter_services(false)
    .append_parameter_override("diagnostic_updater.use_fqn", true)),
  parameters_(declare_all(*this)),
  services_(
    *this, [this] {return made_ != nullptr;}, [this] {
      std::string answer;
      guard([&] {answer = load_model();});
      return answer;
    }),
  clock_(*this, [this](const std::string & what) {on_time_jump(what);}),
  updater_(this, NEVER_S),  // its timer stands still with simulated time: `watch` updates it
  details_(rclcpp::create_publisher<diagnostic_msgs::msg::DiagnosticArray>(*this, "~/details", rclcpp::QoS(1))) {
  warn_of_unknown(*this);
  name_tasks();
  model_checks_ = add_on_set_parameters_callback([this](const auto & changed) {return check_model(changed);});
  model_loads_ = add_post_set_parameters_callback(
    [this](const auto &) {if (loaded_) {next_ = std::exchange(loaded_, nullptr);}});
  parameters_->setUserCallback([this](const observer::Params & changed) {guard([&] {apply(changed);});});
  watched_ = rolled_ = reported_ = read_clock(CLOCK_MONOTONIC);
  timer_ = create_wall_timer(WATCH_PERIOD, [this] {guard([this] {watch();});});
  if (parameters_->get_params().autostart) {start();}
}

// Name the tasks of the diagnostics by the joint, as it is set now.
void ObserverNode::name_tasks() {
  const auto parameters = parameters_->get_params();
  const auto joint = find_joint(parameters.name, parameters.position.field);
  if (joint == joint_) {return;}
  for (const auto * task : TASKS) {updater_.removeByName(joint_ + " " + task);}
  joint_ = joint;
  updater_.setHardwareID(joint_);
  for (std::size_t k = 0; k < TASKS.size(); ++k) {
    updater_.add(joint_ + " " + TASKS[k], [this, k](Status & status) {
        tasks_[k].summarise(status);
        for (const auto & key : KEYS[k]) {
          for (const auto & one : values_.values) {
            if (one.key == key) {status.values.push_back(one);}
          }
        }
      });
  }
}

ObserverNode::Transition ObserverNode::on_configure(const State &) {
  try {
    name_tasks();
    made_ = std::make_unique<Observation>(
      *this, clock_, joint_, [this] {report_change();}, [this](const std::string & what) {on_error(what);});
    apply(parameters_->get_params());
  } catch (const std::exception & error) {
    mistake_ = error.what();
    if (!is_starting_) {RCLCPP_ERROR(get_logger(), "%s", error.what());}
    let_go();
    return dynamic_cast<const UserError *>(&error) ? Transition::FAILURE : Transition::ERROR;
  }
  const auto & model = made_->damper.model();
  RCLCPP_INFO(
    get_logger(), "%s: %s; inputs outside the envelope are %s; %s; SHA-256 %.12s", joint_.c_str(), model.size.c_str(),
    model.outside.c_str(), model.is_proved ? model.claim.c_str() : "not proved stable", model.digest.c_str());
  return Transition::SUCCESS;
}

ObserverNode::Transition ObserverNode::on_activate(const State & state) {
  const auto parameters = parameters_->get_params();
  guard([&] {if (!parameters.autostart) {bond_.open(*this, parameters.bond_heartbeat_period);}});
  return Node::on_activate(state);
}

ObserverNode::Transition ObserverNode::on_deactivate(const State & state) {
  guard([this] {bond_.close();});
  const auto done = Node::on_deactivate(state);
  return has_fallen_ ? Transition::ERROR : done;
}

ObserverNode::Transition ObserverNode::on_cleanup(const State &) {
  has_fallen_ = false;
  guard([this] {bond_.close();});
  let_go();
  mismatch_.clear();
  reported_reason_ = Reason::SILENT;
  return Transition::SUCCESS;
}

// Let go of all topics, and wake the executor: until it has seen them go, it takes new ones at the same addresses for
// them, and does not read them (ros2/rclcpp issue 2180).
void ObserverNode::let_go() {
  made_.reset();
  get_node_base_interface()->trigger_notify_guard_condition();
}

// Configure and activate the node; raises UserError if it cannot.
void ObserverNode::start() {
  mistake_ = "the node cannot be started";
  is_starting_ = true;
  configure();
  is_starting_ = false;
  if (get_current_state().id() == States::PRIMARY_STATE_INACTIVE) {activate();}
  if (get_current_state().id() != States::PRIMARY_STATE_ACTIVE) {throw UserError(mistake_);}
}

// Go through the error state to `unconfigured`; a node that starts itself does so again, after RETRY.
void ObserverNode::fall() {
  RCLCPP_ERROR(
    get_logger(), "%s: each sample has failed for 5 s; the node lets go of everything and is unconfigured",
    joint_.c_str());
  has_fallen_ = true;
  deactivate();
  if (parameters_->get_params().autostart) {next_start_ = read_clock(CLOCK_MONOTONIC) + RETRY;}
}

// Restart after a time jump.
void ObserverNode::on_time_jump(const std::string & what) {
  guard([this, &what] {  // rcl calls this in the middle of setting its clock
      RCLCPP_WARN_THROTTLE(get_logger(), steady_, 1000, "%s: the estimates restart", what.c_str());
      if (!made_) {return;}
      made_->reset(what);
      report_change();
    });
}

// Count an unexpected error for the next diagnostics; no message may end the node.
void ObserverNode::on_error(const std::string & what) noexcept {
  ++failures_;
  try {
    failure_ = what;
  } catch (...) {
    failure_.clear();
  }
}

void ObserverNode::apply(const observer::Params & parameters) {
  if (made_) {made_->set_live(parameters.max_age_s, parameters.wait_for_current_s, parameters.still_warn_s);}
}

// Read the file that the parameter `model` is to name; refuse it, or keep the model until the parameter is set.
rcl_interfaces::msg::SetParametersResult ObserverNode::check_model(const std::vector<rclcpp::Parameter> & changed) {
  rcl_interfaces::msg::SetParametersResult result;
  result.successful = true;
  loaded_.reset();
  try {
    for (const auto & one : changed) {
      if (one.get_name() != "model" || one.get_type() != rclcpp::PARAMETER_STRING) {continue;}
      if (made_ && one == get_parameter("model")) {continue;}
      loaded_ = ces::load_model(*this, one.as_string());
      if (made_) {made_->damper.require_motion(*loaded_);}
    }
  } catch (const UserError & error) {
    loaded_.reset();
    result.successful = false;
    result.reason = error.what();
  }
  return result;
}

// Let the model of the parameter that was set take over, and return what to answer; not while it is set, as then the
// topics of its delayed estimates cannot be made.
std::string ObserverNode::load_model() {
  const auto model = std::exchange(next_, nullptr);
  return made_ && model ? made_->changes.adopt(model) : "";
}

// Do what is due; a step that fails does not keep the others from being done.
void ObserverNode::watch() {
  const auto now = read_clock(CLOCK_MONOTONIC), elapsed = now - watched_;
  watched_ = now;
  guard([this] {clock_.watch();});
  guard([this] {load_model();});
  guard([&] {if (made_) {made_->watch(elapsed);}});
  guard([&] {bond_.watch(now);});
  guard([&] {watch_failures(now);});
  if (const auto window = now - rolled_; window >= DIAGNOSTICS) {
    rolled_ = now;
    guard([&] {roll(to_s(window));});
    guard([this] {publish_status();});
    guard([this] {publish_details();});
  } else if (is_pending_ || get_current_state().label() != state_) {
    publish_status();
  }
}

// Close a window of `elapsed_s` seconds.
void ObserverNode::roll(double elapsed_s) {
  drops_.roll();
  if (!made_) {return;}
  made_->health.roll(elapsed_s);
  const auto before = std::exchange(mismatch_, made_->find_mismatch());
  if (before != mismatch_ && !mismatch_.empty()) {
    RCLCPP_WARN(get_logger(), "%s: %s", joint_.c_str(), mismatch_.c_str());
  }
}

// Leave the active state if each sample fails, and come back later.
void ObserverNode::watch_failures(Nanoseconds now) {
  if (made_ && made_->failing(now) >= FALL && get_current_state().id() == States::PRIMARY_STATE_ACTIVE) {fall();}
  if (next_start_ == 0 || now < next_start_) {return;}
  next_start_ = now + RETRY;
  try {
    start();
    next_start_ = 0;
  } catch (const UserError & error) {
    RCLCPP_ERROR(get_logger(), "cannot be started again: %s", error.what());
  }
}

// Report a new reason at once, or by the watch timer if the last report was just now.
void ObserverNode::report_change() {
  if (made_->damper.reason() == reported_reason_) {return;}
  reported_reason_ = made_->damper.reason();
  made_->health.note_change(clock_.now());
  is_pending_ = true;
  if (read_clock(CLOCK_MONOTONIC) - reported_ >= WATCH) {publish_status();}
}

void ObserverNode::publish_status() {
  reported_ = read_clock(CLOCK_MONOTONIC);
  is_pending_ = false;
  state_ = get_current_state().label();
  tasks_ = make_tasks();
  collect_values();
  updater_.force_update();
  log_reason();
}

std::array<Task, 4> ObserverNode::make_tasks() {
  if (!made_) {
    const Task task{DiagnosticStatus::WARN, "unconfigured: configure the node to estimate"};
    return {task, task, task, task};
  }
  auto & health = made_->health;
  auto task = health.make_health_task(made_->find_detail());
  task.add(!drops_.find_remark().empty(), drops_.find_remark());
  task.add(
    failures_ > std::exchange(reported_failures_, failures_),
    std::to_string(failures_) + " unexpected errors, the last: " + failure_);
  if (get_current_state().id() != States::PRIMARY_STATE_ACTIVE) {
    task = {DiagnosticStatus::WARN, "inactive: activate the node to publish"};
  }
  return {task, health.make_frequency_task(mismatch_), health.make_stamps_task(),
    {DiagnosticStatus::OK, made_->damper.model().size}};
}

void ObserverNode::collect_values() {
  values_.values.clear();
  values_.add("state", state_);
  values_.add("unexpected errors", std::to_string(failures_) + ", the last: " + failure_);
  if (!made_) {return;}
  made_->health.add_values(values_);
  made_->changes.add_values(values_);
  drops_.add_values(values_);
}

// Publish all values, if somebody listens.
void ObserverNode::publish_details() {
  if (details_->get_subscription_count() == 0) {return;}
  diagnostic_msgs::msg::DiagnosticArray message;
  message.header.stamp = get_clock()->now();
  values_.name = get_fully_qualified_name() + (": " + joint_);
  values_.hardware_id = joint_;
  message.status = {values_};
  details_->publish(message);
}

void ObserverNode::log_reason() {
  Task all = tasks_[0];
  for (std::size_t k = 1; k < tasks_.size() && made_; ++k) {
    all.level = std::max(all.level, tasks_[k].level);
    all.remarks.insert(all.remarks.end(), tasks_[k].remarks.begin(), tasks_[k].remarks.end());
  }
  all.summarise(values_);
  const bool is_active = get_current_state().id() == States::PRIMARY_STATE_ACTIVE;
  const auto line = reason_log_.find_line(
    reported_, is_active && made_ ? text_of(made_->damper.reason()) : state_, joint_ + ": " + values_.message,
    made_ ? made_->health.changes() : 0, made_ ? made_->health.withheld() : 0);
  if (!line.empty() && values_.level == DiagnosticStatus::OK) {
    RCLCPP_INFO(get_logger(), "%s", line.c_str());
  } else if (!line.empty()) {
    RCLCPP_WARN(get_logger(), "%s", line.c_str());
  }
}

int run_observer(int argc, char ** argv) {
  int status = 0;
  try {
    rclcpp::init(argc, argv);
    const auto node = std::make_shared<ObserverNode>(rclcpp::NodeOptions());
    rclcpp::executors::SingleThreadedExecutor executor;
    executor.add_node(node->get_node_base_interface());
    std::set<std::string> logged;
    for (bool is_over = false; rclcpp::ok() && !is_over; ) {
      try {
        executor.spin();
        is_over = true;
      } catch (const std::exception & error) {  // in rclcpp itself, as for a /clock before 1970
        if (logged.size() < MAX_LOGGED && logged.insert(error.what()).second) {
          RCLCPP_ERROR(node->get_logger(), "error in rclcpp, logged once; the node runs on: %s", error.what());
        }
        std::this_thread::sleep_for(PAUSE);
      }
    }
    executor.remove_node(node->get_node_base_interface());
  } catch (const std::exception & error) {
    const std::string text = error.what();
    RCLCPP_FATAL(rclcpp::get_logger("observer"), "%s", text.substr(0, text.find('\n')).c_str());
    status = USER_ERROR;
  }
  if (rclcpp::ok()) {rclcpp::shutdown();}
  return status;
}

}  // namespace ces

RCLCPP_COMPONENTS_REGISTER_NODE(ces::ObserverNode)
