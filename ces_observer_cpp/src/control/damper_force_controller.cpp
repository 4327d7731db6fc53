// The observer as a chainable controller of ros2_control: a position and a current in, the damping force out.
//
// It claims JOINT/position and the interfaces of the other inputs, commands nothing, and exports the state interface
// CONTROLLER/JOINT/damping_force [N], which is NaN while the force is withheld. An update allocates nothing, waits for
// no lock, and logs nothing: once a second a timer of the controller's node tells the reason, if it is another.

#include <array>
#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <controller_interface/chainable_controller_interface.hpp>
#include <pluginlib/class_list_macros.hpp>

#include "core/damper.hpp"
#include "ces_observer_cpp/damper_force_controller_parameters.hpp"

namespace ces_observer_cpp {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

class DamperForceController : public controller_interface::ChainableControllerInterface {
public:
  CallbackReturn on_init() override {
    try {
      parameters_ = std::make_shared<damper_force_controller::ParamListener>(get_node());
    } catch (const std::exception & error) {
      return refuse(error.what());
    }
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override {
    const auto given = parameters_->get_params();
    ces::ModelPtr model;
    try {
      model = ces::read_model(given.model, given.allow_uncertified);
    } catch (const ces::UserError & error) {
      return refuse(error.what());
    }
    if (model->delay_ticks) {
      return refuse(given.model + ": gives its forces after a delay; expected a model with a force at each sample (--delay 0)");
    }
    inputs_[ces::POSITION] = {given.joint + "/position", given.position.scale, given.position.offset};
    const auto constant = given.current.constant;
    const bool is_measured = std::isnan(constant) || !given.current.interface.empty();
    inputs_[ces::CURRENT] = {
      !is_measured ? "" : given.current.interface.empty() ? given.joint + "/current" : given.current.interface,
      given.current.scale, given.current.offset};
    motion_ = model->motion;
    const std::string motion = motion_ == ces::SPEED ? "velocity" : ces::MOTIONS[motion_];
    inputs_[ces::MOTION] = {
      motion.empty() ? "" : given.motion.interface.empty() ? given.joint + "/" + motion : given.motion.interface,
      given.motion.scale, given.motion.offset};
    for (const auto & [name, scale, offset] : inputs_) {
      if (scale == 0.0 || !std::isfinite(scale) || !std::isfinite(offset)) {
        return refuse("scale and offset of " + name + ": expected finite numbers, a scale other than 0");
      }
    }
    ces::Damper::Motions motions;
    motions[motion_].emplace();
    damper_.emplace(
      model, ces::SignalHold(is_measured ? std::nullopt : std::optional<double>(constant)), std::move(motions));
    max_still_ = ces::to_ns(given.max_still_s);
    force_name_ = given.joint + "/damping_force";
    timer_ = get_node()->create_wall_timer(std::chrono::seconds(1), [this] {report();});
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override {
    return {interface_configuration_type::NONE, {}};
  }

  InterfaceConfiguration state_interface_configuration() const override {
    InterfaceConfiguration claimed{interface_configuration_type::INDIVIDUAL, {}};
    for (const auto & input : inputs_) {
      if (!input.name.empty()) {claimed.names.push_back(input.name);}
    }
    return claimed;
  }

  std::vector<hardware_interface::StateInterface::SharedPtr> on_export_state_interfaces_list() override {
    force_ = std::make_shared<hardware_interface::StateInterface>(get_node()->get_name(), force_name_);
    return {force_};
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override {
    damper_->reset();
    position_m_ = ces::NOT_A_NUMBER;
    write(ces::NOT_A_NUMBER);
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override {
    write(ces::NOT_A_NUMBER);
    return CallbackReturn::SUCCESS;
  }

  return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) override {
    return return_type::OK;
  }

  return_type update_and_write_commands(const rclcpp::Time & time, const rclcpp::Duration &) override {
    const auto stamp = time.nanoseconds();
    std::array<double, 3> values{};
    for (std::size_t i = 0, claimed = 0; i < inputs_.size(); ++i) {
      if (!inputs_[i].name.empty()) {
        const auto value = state_interfaces_[claimed++].get_optional();
        values[i] = value ? inputs_[i].scale * *value + inputs_[i].offset : ces::NOT_A_NUMBER;
      }
    }
    // One that is not finite is withheld here: it would be explained in text, which allocates.
    if (std::isfinite(values[ces::CURRENT])) {damper_->take_current(stamp, values[ces::CURRENT]);}
    if (motion_ != ces::NO_MOTION_SIGNAL && std::isfinite(values[ces::MOTION])) {
      damper_->take_motion(motion_, stamp, values[ces::MOTION]);
    }
    auto force = damper_->step(stamp, values[ces::POSITION], stamp);
    const char * reason = force ? "" : ces::text_of(damper_->reason());
    if (is_still(stamp, values[ces::POSITION]) && force) {
      force.reset();
      reason = "the position has not changed: at rest, or its sensor is stuck";
    }
    write(force.value_or(ces::NOT_A_NUMBER));
    withheld_.fetch_add(!force, std::memory_order_relaxed);
    reason_.store(reason, std::memory_order_relaxed);
    return return_type::OK;
  }

private:
  struct Input {
    std::string name;  // of the state interface; empty: none
    double scale = 1.0, offset = 0.0;
  };

  CallbackReturn refuse(const std::string & error) const {
    RCLCPP_ERROR(get_node()->get_logger(), "%s", error.c_str());
    return CallbackReturn::ERROR;
  }

  // Whether the position has been the same for so long that it tells nothing about the force.
  bool is_still(ces::Nanoseconds stamp, double position_m) {
    if (position_m != position_m_ || stamp < since_) {
      position_m_ = position_m;
      since_ = stamp;
    }
    return max_still_ > 0 && stamp - since_ >= max_still_;
  }

  // A reader may hold the interface for a moment; the old force must not stay.
  void write(double force_N) {
    for (int i = 0; i < 100 && !force_->set_value(force_N); ++i) {std::this_thread::yield();}
  }

  void report() {
    const bool is_active = get_lifecycle_id() == lifecycle_msgs::msg::State::PRIMARY_STATE_ACTIVE;
    const std::string reason = is_active ? reason_.load(std::memory_order_relaxed) : "";
    if (reason == told_) {return;}
    const auto logger = get_node()->get_logger();
    if (reason.empty()) {
      const auto count = std::to_string(withheld_.load(std::memory_order_relaxed));
      const char * state = is_active ? "estimating" : "inactive";
      RCLCPP_INFO(logger, "%s, after %s; %s forces were withheld so far", state, told_.c_str(), count.c_str());
    } else {
      RCLCPP_WARN(logger, "damping force withheld: %s", reason.c_str());
    }
    told_ = reason;
  }

  std::shared_ptr<damper_force_controller::ParamListener> parameters_;
  std::array<Input, 3> inputs_;  // by ces::Input
  std::optional<ces::Damper> damper_;
  ces::Motion motion_ = ces::NO_MOTION_SIGNAL;
  ces::Nanoseconds max_still_ = 0, since_ = 0;
  double position_m_ = ces::NOT_A_NUMBER;
  std::string force_name_, told_;
  hardware_interface::StateInterface::SharedPtr force_;
  rclcpp::TimerBase::SharedPtr timer_;
  std::atomic<const char *> reason_{""};  // empty: none
  std::atomic<std::uint64_t> withheld_{0};
};

}  // namespace ces_observer_cpp

PLUGINLIB_EXPORT_CLASS(ces_observer_cpp::DamperForceController, controller_interface::ChainableControllerInterface)
