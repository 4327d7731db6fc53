// The observer of one damper: samples in; a force, or the reason why it is withheld, and counts for diagnostics out.
//
// It does not use ROS: stamps are integers, and the node's time is an argument. `Intake` holds positions back that are
// to wait for their current. With finite samples nothing is allocated after construction.
#pragma once

#include <array>
#include <cstdlib>
#include <functional>

#include "core/samples.hpp"
#include "model/estimator.hpp"

namespace ces {

// Counts since the start.
struct Tally {
  std::uint64_t samples = 0, estimates = 0;
  std::uint64_t late = 0;  // forces of earlier samples, that a model with a delay gives
  std::uint64_t clamped = 0;  // forces from inputs outside the envelope
  std::uint64_t held = 0;  // forces held at the end of the force envelope
  std::uint64_t unreadable = 0;  // messages without the configured field
  std::array<std::uint64_t, REASON_TEXTS.size()> withheld{};  // by reason

  std::uint64_t withheld_samples() const {return samples - estimates;}
};

enum Input : std::size_t {POSITION, CURRENT, MOTION};

class Damper {
public:
  using Motions = std::array<std::optional<SignalHold>, 3>;  // by Motion, of those that are measured

  // Raises UserError if the model needs a motion that is not measured.
  Damper(ModelPtr model, SignalHold current, Motions motions)
  : current_(std::move(current)), motions_(std::move(motions)) {
    motions_[NO_MOTION_SIGNAL].emplace(0.0);
    estimator_ = make_estimator(std::move(model));
  }

  // Let a model take over as soon as it has warmed up beside the running one, instead of any other that is warming up.
  // Raises UserError as above.
  void load(ModelPtr model) {
    next_ = make_estimator(std::move(model));
    retired_.reset();
  }

  // Raise UserError if a model needs a motion that is not measured.
  void require_motion(const Model & model) const {
    if (motions_[model.motion]) {return;}
    const std::string motion = MOTIONS[model.motion];
    throw UserError(
      "the model needs the signal '" + motion + "', too; set " + motion + ".topic, " + motion + ".type and " + motion +
      ".field");
  }

  // The largest difference between a position's stamp and the node's clock, in either direction, at which its force is
  // returned, plus the delay for those in `late`; 0 switches the check off.
  void set_max_age(double max_age_s) {max_age_ = to_ns(max_age_s);}

  // Forget currents and motions if they go on after `since`: the clock of the positions was set back.
  void forget_inputs(Nanoseconds since) {
    if (current_.newest() >= since) {current_.reset();}
    for (auto & motion : motions_) {if (motion && motion->newest() >= since) {motion->reset();}}
  }

  // Forget all samples and currents, as after a time jump; keep counts and models.
  void reset() {
    current_.reset();
    for (auto & motion : motions_) {if (motion) {motion->reset();}}
    estimator_->reset();
    if (next_) {next_->reset();}
    late_.clear();
    late_stamp_ = 0;
    if (reason_ != Reason::SILENT) {reason_ = Reason::WARMING_UP;}
  }

  void take_current(Nanoseconds stamp, double current_A) {
    note_value(CURRENT, "current", current_A);
    current_.add(stamp, current_A);
  }

  void take_motion(Motion motion, Nanoseconds stamp, double value) {
    note_value(MOTION, MOTIONS[motion], value);
    motions_[motion]->add(stamp, value);
  }

  // The force [N] at `stamp`, or nothing with `reason` set; `now` is the node's clock. It also sets `late`.
  std::optional<double> step(Nanoseconds stamp, double position_m, Nanoseconds now) {
    ++tally_.samples;
    stamp_ = stamp;
    position_m_ = position_m;
    age_ = now - stamp;
    errors_[POSITION].clear();
    auto force = run(*estimator_);
    if (next_) {
      const auto next_force = run(*next_);
      if (next_->is_warm()) {
        force = next_force;
        next_->skip_late(late_stamp_);
        retired_ = std::exchange(estimator_, std::move(next_));  // it is freed later
      }
    }
    take_late(now);
    // A model with a delay has no force here, but is well after its warm-up.
    const bool is_well = force || estimator_->reason() != Reason::OK;
    reason_ = find_reason(is_well ? force : std::optional<double>(0.0));
    if (reason_ != Reason::OK) {
      ++tally_.withheld[reason_];
      return std::nullopt;
    }
    ++tally_.estimates;
    tally_.clamped += estimator_->is_clamped();
    tally_.held += estimator_->is_held();
    return force;
  }

  // The estimates of earlier samples that the last step has brought and that may be published, each stamp once.
  const std::vector<Estimate> & late() const {return late_;}

  // The half-width [N] of the band around the force that `step` has just returned; not finite without one.
  double half_width() const {return estimator_->half_width();}

  // Count a message without its field; `error` explains missing samples.
  void count_unreadable(Input input, const std::string & error) {
    ++tally_.unreadable;
    errors_[input] = error;
  }

  void report_silence() {reason_ = Reason::SILENT;}

  // Details of the reason, empty if there are none.
  std::string explain() const {
    switch (reason_) {
      case Reason::SILENT:
        return errors_[POSITION];
      case Reason::NO_CURRENT:
        return errors_[CURRENT].empty() ? current_.explain(stamp_, model().max_current_age_s, "current") :
               errors_[CURRENT];
      case Reason::NO_MOTION:
        return errors_[MOTION].empty() ? motion().explain(stamp_, model().max_gap_s, MOTIONS[model().motion]) :
               errors_[MOTION];
      case Reason::WARMING_UP:
        return estimator_->cause();
      case Reason::BEYOND_STROKE:
        return format_number("%g m, the model takes ", position_m_) + format_number("%g to ", model().stroke_min_m) +
               format_number("%g m; check scale and offset", model().stroke_max_m);
      case Reason::OFF_CLOCK:
      case Reason::OUT_OF_ORDER:
        if (stamp_ == 0) {return "the header stamp is 0: the publisher does not fill it in";}
        return reason_ == Reason::OFF_CLOCK ? describe_clock_difference() : "";
      default:
        return "";
    }
  }

  const ModelPtr & running() const {return estimator_->model();}
  const Model & model() const {return *running();}
  // The model that is warming up to take over; null: none.
  const Model * next_model() const {return next_ ? next_->model().get() : nullptr;}
  Reason reason() const {return reason_;}
  Nanoseconds age() const {return age_;}
  double position() const {return estimator_->position();}
  double speed() const {return estimator_->speed();}
  const Tally & tally() const {return tally_;}
  const SignalHold & current() const {return current_;}
  const SignalHold & motion() const {return *motions_[model().motion];}  // that the running model needs
  bool measures_motion() const {return motions_[SPEED] || motions_[ACCELERATION];}

private:
  std::unique_ptr<Estimator> make_estimator(ModelPtr model) {
    require_motion(*model);
    late_.reserve(model->delay_ticks + 1);
    return std::make_unique<Estimator>(std::move(model));
  }

  std::optional<double> run(Estimator & estimator) const {
    const auto & model = *estimator.model();
    const double current = current_.at(stamp_, model.max_current_age_s);
    return estimator.step(stamp_, position_m_, current, motions_[model.motion]->at(stamp_, model.max_gap_s));
  }

  void note_value(Input input, const char * name, double value) {
    errors_[input].clear();
    if (std::isfinite(value)) {return;}
    errors_[input] = std::string("the ") + name + " is " + (std::isnan(value) ? "nan" : format_number("%g", value));
  }

  void take_late(Nanoseconds now) {
    late_.clear();
    estimator_->visit_late(
      [this, now](const Estimate & one) {
        late_stamp_ = one.stamp;
        const bool is_fresh = max_age_ == 0 || std::llabs(now - one.stamp) <= max_age_ + model().delay;
        if (is_fresh && std::isfinite(one.position + one.speed + one.force)) {late_.push_back(one);}
      });
    tally_.late += late_.size();
  }

  // The first of these rules that applies.
  Reason find_reason(std::optional<double> force) const {
    if (!std::isfinite(position_m_)) {return Reason::POSITION_NOT_FINITE;}
    if (max_age_ != 0 && std::llabs(age_) > max_age_) {return Reason::OFF_CLOCK;}
    if (!std::isfinite(current_.at(stamp_, model().max_current_age_s))) {return Reason::NO_CURRENT;}
    if (!std::isfinite(motion().at(stamp_, model().max_gap_s))) {return Reason::NO_MOTION;}
    if (!force) {return estimator_->reason();}
    const bool is_finite = std::isfinite(*force) && std::isfinite(position()) && std::isfinite(speed());
    return is_finite ? Reason::OK : Reason::UNBOUNDED;
  }

  std::string describe_clock_difference() const {
    return format_number("%.3g", to_s(std::llabs(age_))) + " s " + (age_ > 0 ? "behind" : "ahead of") +
           " it, max_age_s allows " + format_number("%g", to_s(max_age_)) +
           " s; for a replay or a simulation set use_sim_time: true and let it publish /clock, or set max_age_s: 0.0";
  }

  SignalHold current_;
  Motions motions_;
  std::unique_ptr<Estimator> estimator_, next_, retired_;  // the last ran before
  Nanoseconds max_age_ = 0;
  Tally tally_;
  Reason reason_ = Reason::SILENT;
  Nanoseconds stamp_ = 0, age_ = 0, late_stamp_ = 0;
  double position_m_ = 0.0;
  std::vector<Estimate> late_;
  std::array<std::string, 3> errors_;  // by input
};

// Samples on their way to the estimator. A position that waits for a current stamped no earlier gives a force that
// depends on the stamps alone, not on which of the two queues was read first.
class Intake {
public:
  // Called after each position, in the order of their arrival, with its stamp, its frame and its force if it has one.
  using OnEstimate = std::function<void(Nanoseconds, const std::string &, std::optional<double>)>;

  Intake(Damper & damper, OnEstimate on_estimate)
  : damper_(damper), on_estimate_(std::move(on_estimate)) {}

  // Hold positions back for at most `wait_s` by the node's clock until their current is known; a constant always is.
  void set_wait(double wait_s) {
    const bool measured = !damper_.current().is_constant() || damper_.measures_motion();
    wait_ = measured ? to_ns(wait_s) : 0;
    if (wait_ > 0 && ring_.empty()) {
      ring_.resize(MAX_POSITIONS + 1);
      for (auto & position : ring_) {position.frame.reserve(FRAME_LENGTH);}
    }
  }

  void take_current(Nanoseconds stamp, double current_A, Nanoseconds now) {
    if (damper_.current().shows_jump(stamp)) {release_all(now);}
    damper_.take_current(stamp, current_A);
    release(now);
  }

  void take_motion(Motion motion, Nanoseconds stamp, double value, Nanoseconds now) {
    if (damper_.motion().shows_jump(stamp)) {release_all(now);}
    damper_.take_motion(motion, stamp, value);
    release(now);
  }

  void take_position(Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now) {
    if (stamp < newest_ - JUMP) {
      release_all(now);
      damper_.forget_inputs(newest_ - JUMP);
    }
    newest_ = stamp;
    if (wait_ == 0 && count_ == 0) {
      estimate(stamp, position_m, frame, now);
      return;
    }
    auto & place = ring_[(first_ + count_++) % ring_.size()];
    place.stamp = stamp;
    place.metres = position_m;
    place.frame.assign(frame);
    place.arrival = now;
    release(now);
  }

  // Estimate from the positions whose wait is over. A clock that was set back ends it, too. A position that arrived
  // before simulated time began, at 0, waits from now.
  void release(Nanoseconds now) {
    while (count_ > 0) {
      auto & first = ring_[first_];
      if (first.arrival == 0) {first.arrival = now;}
      const bool waits = std::llabs(now - first.arrival) < wait_ && count_ <= MAX_POSITIONS;
      if (waits && !is_known(first.stamp)) {return;}
      estimate_first(now);
    }
  }

  // Restart after a time jump; positions held back belong to the time before it.
  void reset(Nanoseconds now) {
    release_all(now);
    damper_.reset();
  }

  // Begin anew after a failure, which may have left the estimator half changed.
  void restart() {
    count_ = 0;
    damper_.reset();
  }

private:
  struct Position {
    Nanoseconds stamp = 0;
    double metres = 0.0;
    std::string frame;
    Nanoseconds arrival = 0;
  };

  static constexpr std::size_t MAX_POSITIONS = 10'000;  // several seconds at 1 kHz; beyond it the oldest is released
  static constexpr std::size_t FRAME_LENGTH = 64;

  // Estimate from all positions that wait: after a jump of the stamps no current of their time comes.
  void release_all(Nanoseconds now) {
    while (count_ > 0) {estimate_first(now);}
  }

  // Whether all measured signals that the model needs are known up to `stamp`.
  bool is_known(Nanoseconds stamp) const {
    const auto reaches = [stamp](const SignalHold & signal) {
        return signal.is_constant() || (signal.newest() && *signal.newest() >= stamp);
      };
    return reaches(damper_.current()) && reaches(damper_.motion());
  }

  void estimate_first(Nanoseconds now) {
    const auto & first = ring_[first_];
    first_ = (first_ + 1) % ring_.size();
    --count_;
    estimate(first.stamp, first.metres, first.frame, now);
  }

  void estimate(Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now) {
    on_estimate_(stamp, frame, damper_.step(stamp, position_m, now));
  }

  Damper & damper_;
  OnEstimate on_estimate_;
  Nanoseconds wait_ = 0, newest_ = 0;  // the stamp of the last position
  std::vector<Position> ring_;  // of the positions held back
  std::size_t first_ = 0, count_ = 0;
};

}  // namespace ces
