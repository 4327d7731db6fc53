// Arrival statistics of an input topic: rate, age, jitter and lost messages. The counting is printed from
// ces_observer/health/arrivals.py.
#pragma once

#include <array>

#include "ces_arrivals.h"
#include "core/samples.hpp"

namespace ces {

// What became of samples that are missing in the stamps: paused source, lost on the way, or lost in the node's queue.
class Losses {
public:
  // The topic's queue holds `depth` messages.
  explicit Losses(std::size_t depth) {k_[CES_ARRIVALS_QUEUE_DEPTH] = static_cast<std::int64_t>(depth);}

  // Take the number of the next message, if it has one.
  void take_number(std::optional<std::uint64_t> number) {
    ces_losses_take_number(k_.data(), number.has_value(), static_cast<std::int64_t>(number.value_or(0)));
  }

  // Messages that did not reach the callback; nothing if they have no numbers.
  std::optional<std::int64_t> lost() const {
    return k_[CES_ARRIVALS_NUMBERED] ? std::optional<std::int64_t>(k_[CES_ARRIVALS_LOST]) : std::nullopt;
  }

private:
  friend class Arrivals;
  std::array<std::int64_t, CES_ARRIVALS_K_LOSSES_END> k_{};
};

// One window of a topic. Counts named `total_` are since the start, the others in the window. `dropped` is
// estimated from gaps in the stamps; it is unknown for messages without stamps. Of these samples `lost` are known
// to have been lost, and `overflowed` in the node's own queue; the source has not sent the others. Interruptions
// are stamps out of line with the others, or silences too long to be lost messages.
struct ArrivalFigures {
  std::int64_t samples = 0, total_samples = 0;
  double rate_Hz = 0.0, mean_age_s = 0.0, usual_age_s = 0.0, max_age_s = 0.0, jitter_s = 0.0;
  bool has_dropped = false;
  std::int64_t dropped = 0, total_dropped = 0;
  std::optional<std::int64_t> lost, total_lost;
  std::int64_t overflowed = 0, total_overflowed = 0;
  std::int64_t total_out_of_order = 0, total_duplicates = 0, total_interruptions = 0;
  std::int64_t repeats = 0, interruptions = 0;  // the former out of order, too
};

// Stamps and arrival times go in one by one, each `roll` closes a window of figures; memory does not grow.
class Arrivals {
public:
  Arrivals() {ces_arrivals_reset(s_.data(), k_.data());}

  // `losses` are those of the topic; without stamps in the messages, `take` gets their arrival instead.
  void set_topic(bool stamped, Losses & losses) {
    figures_.has_dropped = stamped;
    losses_ = &losses;
  }

  // Count a message stamped `stamp` that arrived at `now` of the node's clock.
  void take(Nanoseconds stamp, Nanoseconds now) {
    ces_arrivals_take(s_.data(), k_.data(), losses_->k_.data(), stamp, now);
  }

  // Close a window of `elapsed_s` seconds.
  void roll(double elapsed_s) {
    ces_arrivals_roll(s_.data(), k_.data());
    ArrivalFigures next;
    next.has_dropped = figures_.has_dropped;
    next.total_samples = k_[CES_ARRIVALS_USUAL] + k_[CES_ARRIVALS_RARE];
    next.samples = next.total_samples - figures_.total_samples;
    next.rate_Hz = elapsed_s > 0.0 ? static_cast<double>(next.samples) / elapsed_s : 0.0;
    next.mean_age_s = s_[CES_ARRIVALS_MEAN_AGE] * 1e-9;
    next.usual_age_s = to_s(k_[CES_ARRIVALS_USUAL_AGE]);
    next.max_age_s = to_s(k_[CES_ARRIVALS_WINDOW_MAX_AGE]);
    next.jitter_s = s_[CES_ARRIVALS_JITTER] * 1e-9;
    if (next.has_dropped) {
      next.total_dropped = k_[CES_ARRIVALS_DROPPED];
      next.dropped = next.total_dropped - figures_.total_dropped;
      next.total_duplicates = k_[CES_ARRIVALS_DUPLICATES];
    }
    next.total_lost = losses_->lost();
    if (next.total_lost) {next.lost = *next.total_lost - figures_.total_lost.value_or(0);}
    next.total_overflowed = losses_->k_[CES_ARRIVALS_OVERFLOWED];
    next.overflowed = next.total_overflowed - figures_.total_overflowed;
    next.total_out_of_order = k_[CES_ARRIVALS_LATE];
    next.total_interruptions = k_[CES_ARRIVALS_INTERRUPTIONS];
    next.interruptions = next.total_interruptions - figures_.total_interruptions;
    next.repeats = next.total_out_of_order + next.total_duplicates - figures_.total_out_of_order -
      figures_.total_duplicates;
    figures_ = next;
  }

  // Forget the ages of messages: the node's clock was set.
  void restart_ages() {ces_arrivals_restart_ages(s_.data(), k_.data());}

  const ArrivalFigures & figures() const {return figures_;}

private:
  std::array<double, CES_ARRIVALS_S_ARRIVALS_END> s_{};
  std::array<std::int64_t, CES_ARRIVALS_K_ARRIVALS_END> k_{};
  Losses none_{0};  // of an input without a topic
  Losses * losses_ = &none_;
  ArrivalFigures figures_{};
};

}  // namespace ces
