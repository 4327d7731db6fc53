// Samples of one damper on their way to the estimator: positions wait for their current if they are to.
//
// The results go to an `EstimateSink`, in the order of the positions.
#ifndef CORE__INTAKE_HPP_
#define CORE__INTAKE_HPP_

#include <algorithm>
#include <optional>
#include <string>

#include "core/damper.hpp"
#include "core/position_queue.hpp"

namespace ces
{

class EstimateSink
{
public:
  virtual ~EstimateSink() = default;

  // A position has given a force [N].
  virtual void on_force(Nanoseconds stamp, const std::string & frame, double force_N) = 0;

  // A position has been processed; the damper's reason may have changed.
  virtual void on_processed() = 0;
};

class Intake
{
public:
  Intake(Damper & damper, EstimateSink & sink)
  : damper_(damper), sink_(sink) {}

  // Hold positions back for at most `wait_s` until their current is known; a constant current always is.
  void set_wait(double wait_s)
  {
    const bool measured = !damper_.current().is_constant() || !damper_.motion().is_constant();
    positions_.set_wait(measured ? wait_s : 0.0);
  }

  void take_current(Nanoseconds stamp, double current_A, Nanoseconds now)
  {
    damper_.take_current(stamp, current_A);
    release(now);
  }

  void take_motion(Nanoseconds stamp, double value, Nanoseconds now)
  {
    damper_.take_motion(stamp, value);
    release(now);
  }

  void take_position(Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now)
  {
    if (!positions_.is_waiting()) {
      estimate(stamp, position_m, frame, now);
      return;
    }
    positions_.add(stamp, position_m, frame, now);
    release(now);
  }

  // Estimate from the positions whose wait for their current is over.
  void release(Nanoseconds now)
  {
    if (!positions_.is_waiting()) {return;}
    while (const auto * position = positions_.pop_ready(newest_known(), now)) {
      estimate(position->stamp, position->metres, position->frame, now);
    }
  }

  // Restart after a time jump; positions held back belong to the time before it.
  void reset(Nanoseconds now)
  {
    while (const auto * position = positions_.pop()) {
      estimate(position->stamp, position->metres, position->frame, now);
    }
    damper_.reset();
  }

  // Begin anew after a failure, which may have left the estimator half changed.
  void restart()
  {
    positions_.clear();
    damper_.reset();
  }

private:
  // The stamp up to which all measured signals that the model needs are known; nothing: unknown.
  std::optional<Nanoseconds> newest_known() const
  {
    std::optional<Nanoseconds> known;
    for (const auto * signal : {&damper_.current(), &damper_.motion()}) {
      if (signal->is_constant()) {continue;}
      const auto newest = signal->newest();
      if (!newest) {return std::nullopt;}
      known = known ? std::min(*known, *newest) : *newest;
    }
    return known;
  }

  void estimate(Nanoseconds stamp, double position_m, const std::string & frame, Nanoseconds now)
  {
    if (const auto force = damper_.step(stamp, position_m, now)) {sink_.on_force(stamp, frame, *force);}
    sink_.on_processed();
  }

  Damper & damper_;
  EstimateSink & sink_;
  PositionQueue positions_;
};

}  // namespace ces

#endif  // CORE__INTAKE_HPP_
