// The observer of one damper: samples in; a force, or the reason why it is withheld, and counts for diagnostics out.
//
// It does not use ROS: stamps are integers, and the node's time is an argument. After construction, `step` and the
// `take` functions allocate nothing for finite samples.
#ifndef CORE__DAMPER_HPP_
#define CORE__DAMPER_HPP_

#include <cstdint>
#include <optional>
#include <string>

#include "core/numbers.hpp"
#include "core/reason.hpp"
#include "core/signal_hold.hpp"
#include "model/estimator.hpp"

namespace ces
{

// Counts since the start.
struct Tally
{
  std::uint64_t samples = 0, estimates = 0;
  std::uint64_t clamped = 0;  // forces from inputs outside the envelope
  std::uint64_t unreadable = 0;  // messages without the configured field
  ByReason<std::uint64_t> withheld;

  std::uint64_t withheld_samples() const {return samples - estimates;}
};

class Damper
{
public:
  // `max_age_s` is the largest difference between a position's stamp and the node's clock, in either direction, at
  // which its force is returned; 0 switches the check off. `motion` is the signal that the model needs beside the
  // position.
  Damper(SignalHold current, SignalHold motion, double max_age_s);

  void set_max_age(double max_age_s) {max_age_ = to_ns(max_age_s);}

  // Forget all samples and currents, as after a time jump; keep counts.
  void reset();

  void take_current(Nanoseconds stamp, double current_A);
  void take_motion(Nanoseconds stamp, double value);

  // The force [N] at `stamp`, or nothing with `reason` set; `now` is the node's clock.
  std::optional<double> step(Nanoseconds stamp, double position_m, Nanoseconds now);

  // The half-width [N] of the band around the force that `step` has just returned; nothing without one.
  std::optional<double> half_width() const;

  void count_unreadable_position(const std::string & error) {count_unreadable(position_error_, error);}
  void count_unreadable_current(const std::string & error) {count_unreadable(current_error_, error);}
  void count_unreadable_motion(const std::string & error) {count_unreadable(motion_error_, error);}

  void report_silence() {reason_ = Reason::SILENT;}

  // Details of the reason, empty if there are none.
  std::string explain() const;

  Reason reason() const {return reason_;}
  Nanoseconds age() const {return age_;}
  double position() const {return estimator_.position();}
  double speed() const {return estimator_.speed();}
  const Tally & tally() const {return tally_;}
  const SignalHold & current() const {return current_;}
  const SignalHold & motion() const {return motion_;}

private:
  void count_unreadable(std::string & last, const std::string & error);
  Reason find_reason(std::optional<double> force, double position, double current, double motion) const;
  bool is_off_clock() const;
  std::string describe_clock_difference() const;

  Estimator estimator_;
  SignalHold current_, motion_;
  Nanoseconds max_age_ = 0;
  Tally tally_;
  Reason reason_ = Reason::SILENT;
  Nanoseconds stamp_ = 0, age_ = 0;
  std::string position_error_, current_error_, motion_error_;
};

}  // namespace ces

#endif  // CORE__DAMPER_HPP_
