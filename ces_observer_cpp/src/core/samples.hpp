// Samples of a signal: times as whole nanoseconds, and the value that holds at a position sample.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <iterator>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace ces {

using Nanoseconds = std::int64_t;

constexpr Nanoseconds SECOND = 1'000'000'000;
constexpr Nanoseconds JUMP = SECOND;  // a stamp this much before the newest shows that the clock was set back
constexpr double NOT_A_NUMBER = std::numeric_limits<double>::quiet_NaN();

inline Nanoseconds to_ns(double seconds) {return static_cast<Nanoseconds>(std::nearbyint(seconds * 1e9));}

inline double to_s(Nanoseconds time) {return static_cast<double>(time) * 1e-9;}

// The text of a format for one number, such as "%.3g".
inline std::string format_number(const char * format, double value) {
  char text[400];  // "%.1f" of the largest double has 311 characters
  std::snprintf(text, sizeof text, format, value);
  return text;
}

// The texts with `separator` between them.
template<typename Texts>
std::string join(const Texts & texts, const std::string & separator) {
  std::string joined;
  for (const auto & text : texts) {joined += (joined.empty() ? "" : separator) + text;}
  return joined;
}

// The value of a signal at a position sample: the newest one stamped no later, if it is not too old.
//
// A history is kept because the signals come in separate queues, so that a current may arrive before a position
// that was measured earlier. After construction nothing is allocated.
class SignalHold {
public:
  // A measured signal, or a known value that does not age.
  explicit SignalHold(std::optional<double> constant = std::nullopt)
  : constant_(constant) {
    if (!constant) {samples_.reserve(2 * HISTORY + 1);}
  }

  bool is_constant() const {return constant_.has_value();}

  // The latest stamp of a known value.
  std::optional<Nanoseconds> newest() const {
    return samples_.empty() ? std::nullopt : std::optional<Nanoseconds>(samples_.back().first);
  }

  void reset() {samples_.clear();}

  // Whether a value stamped so shows that the clock was set back.
  bool shows_jump(Nanoseconds stamp) const {return newest() && stamp < *newest() - JUMP;}

  // Add a value; one that is not finite is ignored, as is any if the signal is constant.
  void add(Nanoseconds stamp, double value) {
    if (constant_ || !std::isfinite(value)) {return;}
    if (shows_jump(stamp)) {reset();}
    samples_.insert(find_later(stamp), {stamp, value});
    if (samples_.size() > 2 * HISTORY) {samples_.erase(samples_.begin(), samples_.begin() + HISTORY);}
  }

  // The value that holds at `stamp` and is not older than `max_age_s`, or NaN.
  double at(Nanoseconds stamp, double max_age_s) const {
    if (constant_) {return *constant_;}
    const auto later = find_later(stamp);
    if (later == samples_.begin() || stamp - std::prev(later)->first > to_ns(max_age_s)) {return NOT_A_NUMBER;}
    return std::prev(later)->second;
  }

  // Why `at` is NaN at `stamp` for the signal `name`; empty if no value was received at all.
  std::string explain(Nanoseconds stamp, double max_age_s, const std::string & name) const {
    if (samples_.empty()) {return "";}
    const auto later = find_later(stamp);
    if (later == samples_.begin()) {
      const auto ahead = to_s(later->first - stamp);
      return "the position was measured " + format_number("%.3g", ahead) + " s before the first known " + name +
             (ahead > max_age_s ? ": are both on one clock?" : "");
    }
    return "the newest " + name + " is " + format_number("%.3g", to_s(stamp - std::prev(later)->first)) +
           " s older than the position; the model allows " + format_number("%g", max_age_s) + " s";
  }

private:
  using Samples = std::vector<std::pair<Nanoseconds, double>>;

  static constexpr std::ptrdiff_t HISTORY = 8192;  // more than a subscription's queue holds: a burst loses none

  // The first value stamped later; mostly there is none.
  Samples::const_iterator find_later(Nanoseconds stamp) const {
    if (samples_.empty() || samples_.back().first <= stamp) {return samples_.end();}
    return std::upper_bound(
      samples_.begin(), samples_.end(), stamp, [](Nanoseconds at, const auto & sample) {return at < sample.first;});
  }

  std::optional<double> constant_;
  Samples samples_;
};

}  // namespace ces
