// The value of a signal at a position sample: the newest one stamped no later, if it is not too old.
//
// A history is kept because the signals come in separate queues, so that a current may arrive before a position
// that was measured earlier. After construction nothing is allocated.
#ifndef CORE__SIGNAL_HOLD_HPP_
#define CORE__SIGNAL_HOLD_HPP_

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "core/numbers.hpp"

namespace ces
{

class SignalHold
{
public:
  // A signal that is measured; a value older than `max_age_s` is not used.
  static SignalHold measured(double max_age_s);

  // A known value that is not measured and does not age.
  static SignalHold constant(double value);

  bool is_constant() const {return constant_.has_value();}

  // The latest stamp of a known value.
  std::optional<Nanoseconds> newest() const;

  void reset();

  // Add a value; one that is not finite is ignored, as is any if the signal is constant.
  void add(Nanoseconds stamp, double value);

  // The value that holds at `stamp`, or NaN.
  double at(Nanoseconds stamp) const;

  // Why `at` is NaN at `stamp` for the signal `name`; empty if no value was received at all.
  std::string explain(Nanoseconds stamp, const std::string & name) const;

private:
  SignalHold(double max_age_s, std::optional<double> constant);

  std::size_t count_until(Nanoseconds stamp) const;

  Nanoseconds max_age_;
  std::optional<double> constant_;
  std::vector<Nanoseconds> stamps_;
  std::vector<double> values_;
};

}  // namespace ces

#endif  // CORE__SIGNAL_HOLD_HPP_
