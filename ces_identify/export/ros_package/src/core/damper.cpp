#include "core/damper.hpp"

#include <utility>

namespace ces
{

Damper::Damper(SignalHold current, SignalHold motion, double max_age_s)
: current_(std::move(current)), motion_(std::move(motion))
{
  set_max_age(max_age_s);
}

void Damper::reset()
{
  current_.reset();
  motion_.reset();
  estimator_.reset();
  if (reason_ != Reason::SILENT) {reason_ = Reason::WARMING_UP;}
}

void Damper::take_current(Nanoseconds stamp, double current_A)
{
  current_error_ = std::isfinite(current_A) ? "" : "the current is " + format_value(current_A);
  current_.add(stamp, current_A);
}

void Damper::take_motion(Nanoseconds stamp, double value)
{
  motion_error_ = std::isfinite(value) ? "" : std::string("the ") + Model::MOTION + " is " + format_value(value);
  motion_.add(stamp, value);
}

std::optional<double> Damper::step(Nanoseconds stamp, double position_m, Nanoseconds now)
{
  ++tally_.samples;
  stamp_ = stamp;
  age_ = now - stamp;
  position_error_.clear();
  const double current = current_.at(stamp), motion = motion_.at(stamp);
  const auto force = estimator_.step(stamp, position_m, current, motion);
  reason_ = find_reason(force, position_m, current, motion);
  if (reason_ != Reason::OK) {
    ++tally_.withheld[reason_];
    return std::nullopt;
  }
  ++tally_.estimates;
  tally_.clamped += estimator_.is_clamped();
  return force;
}

std::optional<double> Damper::half_width() const
{
  const double width = estimator_.half_width();
  return std::isfinite(width) ? std::optional<double>(width) : std::nullopt;
}

// The first of these rules that applies.
Reason Damper::find_reason(std::optional<double> force, double position, double current, double motion) const
{
  if (!std::isfinite(position)) {return Reason::POSITION_NOT_FINITE;}
  if (is_off_clock()) {return Reason::OFF_CLOCK;}
  if (!std::isfinite(current)) {return Reason::NO_CURRENT;}
  if (!std::isfinite(motion)) {return Reason::NO_MOTION;}
  if (!force) {return estimator_.reason();}
  const bool finite =
    std::isfinite(*force) && std::isfinite(estimator_.position()) && std::isfinite(estimator_.speed());
  return finite ? Reason::OK : Reason::UNBOUNDED;
}

bool Damper::is_off_clock() const {return max_age_ != 0 && (age_ > max_age_ || age_ < -max_age_);}

void Damper::count_unreadable(std::string & last, const std::string & error)
{
  ++tally_.unreadable;
  last = error;
}

std::string Damper::explain() const
{
  switch (reason_) {
    case Reason::SILENT:
      return position_error_;
    case Reason::NO_CURRENT:
      return current_error_.empty() ? current_.explain(stamp_, "current") : current_error_;
    case Reason::NO_MOTION:
      return motion_error_.empty() ? motion_.explain(stamp_, Model::MOTION) : motion_error_;
    case Reason::OFF_CLOCK:
    case Reason::OUT_OF_ORDER:
      if (stamp_ == 0) {return "the header stamp is 0: the publisher does not fill it in";}
      return reason_ == Reason::OFF_CLOCK ? describe_clock_difference() : "";
    default:
      return "";
  }
}

std::string Damper::describe_clock_difference() const
{
  return format_number("%.3g", to_s(age_ > 0 ? age_ : -age_)) + " s " + (age_ > 0 ? "behind" : "ahead of") +
         " it, max_age_s allows " + format_number("%g", to_s(max_age_)) +
         " s; for a replay or a simulation set use_sim_time: true and let it publish /clock, or set max_age_s: 0.0";
}

}  // namespace ces
