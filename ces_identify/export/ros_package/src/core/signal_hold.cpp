#include "core/signal_hold.hpp"

#include <algorithm>

namespace ces
{
namespace
{

constexpr std::size_t HISTORY = 8192;  // more than a subscription's queue holds, so that a burst loses none
constexpr Nanoseconds JUMP = SECOND;  // a value stamped this much before the newest one shows a clock set back

}  // namespace

SignalHold::SignalHold(double max_age_s, std::optional<double> constant)
: max_age_(to_ns(max_age_s)), constant_(constant)
{
  if (!constant) {
    stamps_.reserve(2 * HISTORY + 1);
    values_.reserve(2 * HISTORY + 1);
  }
}

SignalHold SignalHold::measured(double max_age_s) {return SignalHold(max_age_s, std::nullopt);}

SignalHold SignalHold::constant(double value) {return SignalHold(0.0, value);}

std::optional<Nanoseconds> SignalHold::newest() const
{
  return stamps_.empty() ? std::nullopt : std::optional<Nanoseconds>(stamps_.back());
}

void SignalHold::reset()
{
  stamps_.clear();
  values_.clear();
}

void SignalHold::add(Nanoseconds stamp, double value)
{
  if (constant_ || !std::isfinite(value)) {return;}
  if (!stamps_.empty() && stamp < stamps_.back() - JUMP) {reset();}
  const auto place = static_cast<std::ptrdiff_t>(count_until(stamp));
  stamps_.insert(stamps_.begin() + place, stamp);
  values_.insert(values_.begin() + place, value);
  if (stamps_.size() > 2 * HISTORY) {
    stamps_.erase(stamps_.begin(), stamps_.begin() + HISTORY);
    values_.erase(values_.begin(), values_.begin() + HISTORY);
  }
}

double SignalHold::at(Nanoseconds stamp) const
{
  if (constant_) {return *constant_;}
  const auto count = count_until(stamp);
  if (count == 0 || stamp - stamps_[count - 1] > max_age_) {return NOT_A_NUMBER;}
  return values_[count - 1];
}

std::string SignalHold::explain(Nanoseconds stamp, const std::string & name) const
{
  if (stamps_.empty()) {return "";}
  const auto count = count_until(stamp);
  const auto limit = to_s(max_age_);
  if (count == 0) {
    const auto ahead = to_s(stamps_.front() - stamp);
    return "the position was measured " + format_number("%.3g", ahead) + " s before the first known " + name +
           (ahead > limit ? ": are both on one clock?" : "");
  }
  return "the newest " + name + " is " + format_number("%.3g", to_s(stamp - stamps_[count - 1])) +
         " s older than the position; the model allows " + format_number("%g", limit) + " s";
}

std::size_t SignalHold::count_until(Nanoseconds stamp) const
{
  if (stamps_.empty() || stamps_.back() <= stamp) {return stamps_.size();}
  return static_cast<std::size_t>(std::upper_bound(stamps_.begin(), stamps_.end(), stamp) - stamps_.begin());
}

}  // namespace ces
