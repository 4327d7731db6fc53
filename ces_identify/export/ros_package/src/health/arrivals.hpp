// Arrival statistics of one input topic: rate, age, jitter and lost messages.
//
// Stamps and arrival times go in one by one, each `roll` closes a window of figures; memory does not grow. The
// period is learnt from the stamps and followed. An interval from 0.5 to 1.5 periods is usual and takes a few
// additions; `take_rare` handles all others.
#ifndef HEALTH__ARRIVALS_HPP_
#define HEALTH__ARRIVALS_HPP_

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>

#include "core/numbers.hpp"
#include "health/losses.hpp"

namespace ces
{

// One window of a topic. Counts named `total_` are since the start, the others in the window. `dropped` is
// estimated from gaps in the stamps; it is unknown for messages without stamps. Of these samples `lost` are known
// to have been lost, and `overflowed` in the node's own queue; the source has not sent the others. Interruptions
// are stamps that ran back, or silences too long to be lost messages.
struct ArrivalFigures
{
  std::int64_t samples = 0, total_samples = 0;
  double rate_Hz = 0.0, mean_age_s = 0.0, max_age_s = 0.0, jitter_s = 0.0, longest_s = 0.0;
  std::int64_t burst = 0;  // largest number of messages, each within a quarter of the period after the one before
  bool has_dropped = false;
  std::int64_t dropped = 0, total_dropped = 0;
  std::optional<std::int64_t> lost, total_lost;
  std::int64_t overflowed = 0, total_overflowed = 0;
  std::int64_t total_out_of_order = 0, total_duplicates = 0, total_interruptions = 0;
};

class Arrivals
{
public:
  // `losses` are those of the topic; without stamps in the messages, `take` gets their arrival instead.
  void set_topic(bool stamped, Losses & losses)
  {
    stamped_ = stamped;
    figures_.has_dropped = stamped;
    losses_ = &losses;
  }

  // Count a message stamped `stamp` that arrived at `now` of the node's clock.
  void take(Nanoseconds stamp, Nanoseconds now)
  {
    const Nanoseconds age = now - stamp, step = stamp - newest_;
    age_sum_ += static_cast<double>(age);
    if (age > max_age_) {max_age_ = age;}
    if (short_ < step && step < long_) {
      take_usual(stamp, step);
    } else {
      take_rare(stamp, step, now);
    }
    if (now - now_ < close_) {
      ++run_;
    } else {
      end_run();
    }
    now_ = now;
  }

  // Close a window of `elapsed_s` seconds.
  void roll(double elapsed_s);

  const ArrivalFigures & figures() const {return figures_;}

private:
  static constexpr std::size_t LEARN = 11;  // intervals to learn the period, and unusual ones to learn it again

  struct Spread {double mean, jitter;};

  void take_usual(Nanoseconds stamp, Nanoseconds step)
  {
    newest_ = stamp;
    ++usual_;
    const auto deviation = static_cast<double>(step - period_);
    deviation_ += deviation;
    deviation2_ += deviation * deviation;
    if (step > longest_) {longest_ = step;}
  }

  void end_run()
  {
    if (run_ > max_run_) {max_run_ = run_;}
    run_ = 0;
  }

  void take_rare(Nanoseconds stamp, Nanoseconds step, Nanoseconds now);
  void take_unusual(Nanoseconds step);
  void count_pending();
  void learn(Nanoseconds step);
  void set_period(double period);
  Spread find_spread() const;

  bool stamped_ = true;
  Losses * losses_ = nullptr;
  Nanoseconds newest_ = 0, now_ = 0, period_ = 0, short_ = 0, long_ = 0, close_ = 0;
  Nanoseconds usual_age_ = 0;  // until the first window is closed, as if both clocks were the same
  double age_sum_ = 0.0;
  Nanoseconds longest_ = 0, max_age_ = std::numeric_limits<Nanoseconds>::min();
  std::int64_t run_ = 0, max_run_ = 0, usual_ = 0, rare_ = 0, pending_ = 0, streak_ = 0, streak_at_ = 0;
  std::int64_t missing_ = 0, late_ = 0, duplicates_ = 0, interruptions_ = 0, before_ = 0, unmeasured_ = 0;
  std::array<Nanoseconds, LEARN> steps_{};
  std::size_t learnt_ = 0;
  double deviation_ = 0.0, deviation2_ = 0.0;
  ArrivalFigures figures_{};
};

}  // namespace ces

#endif  // HEALTH__ARRIVALS_HPP_
