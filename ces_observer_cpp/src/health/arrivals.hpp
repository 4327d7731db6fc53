// Arrival statistics of an input topic: rate, age, jitter and lost messages.
#pragma once

#include <array>
#include <cstdlib>
#include <numeric>

#include "core/samples.hpp"

namespace ces
{

// What became of samples that are missing in the stamps: paused source, lost on the way, or lost in the node's queue.
//
// Where the middleware numbers the messages of a publisher, their numbers tell pauses from losses. Where it does
// not, only one cause is certain: the node's own queue was full, if the first message after the gap had waited for
// as long as a full queue takes.
class Losses
{
public:
  // The topic's queue holds `depth` messages.
  explicit Losses(std::size_t depth)
  : depth_(static_cast<double>(depth)) {}

  std::optional<std::int64_t> lost;  // messages that did not reach the callback; nothing if they have no numbers
  std::int64_t overflowed = 0;  // those of them that the node's own queue dropped

  // Take the number of the next message.
  void take_number(std::optional<std::uint64_t> number)
  {
    if (!number || switches_ > MAX_SWITCHES) {
      lost.reset();
      return;
    }
    if (!last_ || *number > *last_) {
      lost = lost.value_or(0) + (last_ ? static_cast<std::int64_t>(*number - *last_) - 1 : 0);
    } else {  // another publisher, or one that was started again
      ++switches_;
    }
    last_ = number;
  }

  // Count `missing` samples as overflowed if the message after them had waited for a full queue; return this.
  bool take_gap(std::int64_t missing, Nanoseconds waited, Nanoseconds period)
  {
    if (lost) {missing = std::min(missing, *lost - overflowed);}
    if (missing <= 0 || static_cast<double>(waited) < FULL_SHARE * depth_ * static_cast<double>(period)) {return false;}
    overflowed += missing;
    return true;
  }

private:
  static constexpr double FULL_SHARE = 0.9;  // of the queue's length in time: the period is an average
  static constexpr int MAX_SWITCHES = 20;  // more show that several publishers share the topic

  double depth_;
  std::optional<std::uint64_t> last_;
  int switches_ = 0;
};

// One window of a topic. Counts named `total_` are since the start, the others in the window. `dropped` is
// estimated from gaps in the stamps; it is unknown for messages without stamps. Of these samples `lost` are known
// to have been lost, and `overflowed` in the node's own queue; the source has not sent the others. Interruptions
// are stamps out of line with the others, or silences too long to be lost messages.
struct ArrivalFigures
{
  std::int64_t samples = 0, total_samples = 0;
  double rate_Hz = 0.0, mean_age_s = 0.0, max_age_s = 0.0, jitter_s = 0.0;
  bool has_dropped = false;
  std::int64_t dropped = 0, total_dropped = 0;
  std::optional<std::int64_t> lost, total_lost;
  std::int64_t overflowed = 0, total_overflowed = 0;
  std::int64_t total_out_of_order = 0, total_duplicates = 0, total_interruptions = 0;
  std::int64_t repeats = 0, interruptions = 0;  // the former out of order, too
};

// Stamps and arrival times go in one by one, each `roll` closes a window of figures; memory does not grow. The
// period is learnt from the stamps and followed. An interval from 0.5 to 1.5 periods is usual and takes a few
// additions; `take_rare` handles all others. A late message, stamped before the newest, cancels a dropped one. A stamp
// further back, or sent after it arrived as the others are stamped, is out of line: it does not count, unless the next
// one confirms it.
class Arrivals
{
public:
  // `losses` are those of the topic; without stamps in the messages, `take` gets their arrival instead.
  void set_topic(bool stamped, Losses & losses)
  {
    figures_.has_dropped = stamped;
    losses_ = &losses;
  }

  // Count a message stamped `stamp` that arrived at `now` of the node's clock.
  void take(Nanoseconds stamp, Nanoseconds now)
  {
    auto age = now - stamp;
    const auto step = stamp - newest_;
    if (0.5 * period_ < static_cast<double>(step) && static_cast<double>(step) < 1.5 * period_) {
      const auto deviation = static_cast<double>(step) - period_;
      newest_ = stamp;
      ++usual_;
      deviation_ += deviation;
      deviation2_ += deviation * deviation;
    } else {
      age = take_rare(stamp, step, age);
    }
    age_sum_ += static_cast<double>(age);
    max_age_ = std::max(max_age_, age);
  }

  // Close a window of `elapsed_s` seconds.
  void roll(double elapsed_s)
  {
    if (usual_ != streak_at_) {count_pending();}
    missing_ = std::max(missing_, late_ + figures_.total_dropped);
    const auto count = static_cast<double>(usual_ - unmeasured_);  // usual intervals since the period was set
    const auto mean = count > 0.0 ? deviation_ / count : 0.0;
    const auto variance = count > 0.0 ? deviation2_ / count - mean * mean : 0.0;
    ArrivalFigures next;
    next.has_dropped = figures_.has_dropped;
    next.total_samples = usual_ + rare_;
    next.samples = next.total_samples - figures_.total_samples;
    const auto aged = next.total_samples - aged_;
    if (aged > 0) {
      next.mean_age_s = age_sum_ / static_cast<double>(aged) * 1e-9;
      next.max_age_s = to_s(max_age_);
      // A window with a stall is none of usual ages.
      usual_age_ = static_cast<Nanoseconds>(std::min(next.mean_age_s, last_age_s_.value_or(next.mean_age_s)) * 1e9);
    }
    last_age_s_ = aged > 0 ? std::optional<double>(next.mean_age_s) : std::nullopt;
    next.rate_Hz = elapsed_s > 0.0 ? static_cast<double>(next.samples) / elapsed_s : 0.0;
    next.jitter_s = std::sqrt(std::max(0.0, variance)) * 1e-9;
    if (next.has_dropped) {
      next.total_dropped = missing_ - late_;
      next.dropped = next.total_dropped - figures_.total_dropped;
      next.total_duplicates = duplicates_;
    }
    if (losses_ != nullptr) {
      next.total_lost = losses_->lost;
      if (next.total_lost) {next.lost = *next.total_lost - figures_.total_lost.value_or(0);}
      next.total_overflowed = losses_->overflowed;
      next.overflowed = next.total_overflowed - figures_.total_overflowed;
    }
    next.total_out_of_order = late_;
    next.total_interruptions = interruptions_;
    next.interruptions = interruptions_ - figures_.total_interruptions;
    next.repeats = late_ + next.total_duplicates - figures_.total_out_of_order - figures_.total_duplicates;
    figures_ = next;
    if (period_ != 0.0) {set_period(period_ + mean);}
    reset_ages();
  }

  // Forget the ages of messages: the node's clock was set.
  void restart_ages()
  {
    reset_ages();
    usual_age_.reset();
    last_age_s_.reset();
  }

  const ArrivalFigures & figures() const {return figures_;}

private:
  static constexpr std::size_t LEARN = 11;  // intervals to learn the period, and unusual ones to learn it again
  static constexpr double BACK = 5e7, BACK_PERIODS = 20.0;  // a stamp further back than both: clock set back, not late
  static constexpr double SILENCE = 1e9, SILENCE_PERIODS = 10.0;  // longer than both: silence, not lost messages
  static constexpr double MAX_LOST_SHARE = 0.5;  // of messages while learning; a period that implies more is rejected

  static std::int64_t count_periods(Nanoseconds step, double period)
  {
    return static_cast<std::int64_t>(std::nearbyint(static_cast<double>(step) / period));
  }

  // Take the mean and maximum of ages from now on.
  void reset_ages()
  {
    aged_ = usual_ + rare_;
    age_sum_ = 0.0;
    max_age_ = std::numeric_limits<Nanoseconds>::min();
  }

  Nanoseconds silence() const {return static_cast<Nanoseconds>(std::max(SILENCE, SILENCE_PERIODS * period_));}

  // Count a message whose stamp is not about one period after the newest; return its age, if usable, or the usual.
  Nanoseconds take_rare(Nanoseconds stamp, Nanoseconds step, Nanoseconds age)
  {
    if (!usual_age_) {usual_age_ = age;}
    if (usual_ + rare_++ == 0) {
      newest_ = stamp;
      return age;
    }
    const auto back = static_cast<Nanoseconds>(std::max(BACK, BACK_PERIODS * period_));
    const auto waited = age - *usual_age_;
    if (step < -back || (step > 0 && waited < -back)) {return take_doubtful(stamp, step, age);}
    doubtful_.reset();
    if (step > 0) {
      take_gap(stamp, step, waited);
    } else {
      ++(step == 0 ? duplicates_ : late_);
    }
    return age;
  }

  // Count a stamp out of line, once; the next one beside it shows that the clock was set.
  Nanoseconds take_doubtful(Nanoseconds stamp, Nanoseconds step, Nanoseconds age)
  {
    const bool is_confirmed = doubtful_ && std::llabs(stamp - *doubtful_) <= silence();
    if (step < 0 || is_confirmed) {pending_ = streak_ = 0;}  // the gap before it was none
    doubtful_ = stamp;
    if (!is_confirmed) {
      ++interruptions_;
      return *usual_age_;
    }
    restart_ages();
    --aged_;  // this message counts
    newest_ = stamp;
    doubtful_.reset();
    usual_age_ = age;
    return age;
  }

  void take_gap(Nanoseconds stamp, Nanoseconds step, Nanoseconds waited)
  {
    newest_ = stamp;
    const auto missing = period_ != 0.0 ? count_periods(step, period_) - 1 : 0;
    const bool overflowed = losses_ != nullptr && losses_->take_gap(missing, waited, static_cast<Nanoseconds>(period_));
    if (overflowed || step <= silence()) {
      take_unusual(step);
    } else {
      ++interruptions_;
    }
  }

  // Learn from an interval, or count the messages missing in it; a short one cancels a long one.
  void take_unusual(Nanoseconds step)
  {
    if (period_ == 0.0) {return learn(step);}
    if (usual_ != streak_at_) {count_pending();}
    pending_ += count_periods(step, period_) - 1;
    if (++streak_ < static_cast<std::int64_t>(LEARN)) {return;}
    const bool is_changed = std::llabs(pending_) > static_cast<std::int64_t>(LEARN / 2);  // the rate: nothing was lost
    if (is_changed) {learnt_ = pending_ = 0;}
    count_pending();
    if (is_changed) {set_period(0.0);}
  }

  // Count the pending messages: usual intervals have ended the row of unusual ones.
  void count_pending()
  {
    missing_ += pending_;
    pending_ = streak_ = 0;
    streak_at_ = usual_;
  }

  void learn(Nanoseconds step)
  {
    steps_[static_cast<std::size_t>(learnt_++) % LEARN] = step;
    if (learnt_ < static_cast<std::int64_t>(LEARN)) {return;}
    auto sorted = steps_;
    std::sort(sorted.begin(), sorted.end());
    auto period = static_cast<double>(sorted[(LEARN - 1) / 2]);
    std::int64_t lost = 0;
    for (const auto one : steps_) {lost += count_periods(one, period) - 1;}
    if (static_cast<double>(lost) > MAX_LOST_SHARE * static_cast<double>(lost + static_cast<std::int64_t>(LEARN))) {
      period = static_cast<double>(std::accumulate(steps_.begin(), steps_.end(), Nanoseconds(0))) / LEARN;
      lost = 0;
    }
    missing_ += std::max(std::int64_t(0), lost);
    set_period(period);
  }

  // Count relative to this period from now on; 0 while it is unknown.
  void set_period(double period)
  {
    period_ = std::nearbyint(period);
    deviation_ = deviation2_ = 0.0;
    unmeasured_ = streak_at_ = usual_;
  }

  Losses * losses_ = nullptr;
  double period_ = 0.0;  // [ns]
  Nanoseconds newest_ = 0;
  std::optional<Nanoseconds> usual_age_;  // that of the first message until a window is closed
  std::optional<double> last_age_s_;  // the mean of the last window
  std::optional<Nanoseconds> doubtful_;  // the last stamp, if it was out of line
  double age_sum_ = 0.0;
  Nanoseconds max_age_ = std::numeric_limits<Nanoseconds>::min();
  std::int64_t usual_ = 0, rare_ = 0, pending_ = 0, streak_ = 0, streak_at_ = 0, learnt_ = 0;
  std::int64_t missing_ = 0, late_ = 0, duplicates_ = 0, interruptions_ = 0, unmeasured_ = 0;
  std::int64_t aged_ = 0;  // messages before those whose ages count
  std::array<Nanoseconds, LEARN> steps_{};
  double deviation_ = 0.0, deviation2_ = 0.0;
  ArrivalFigures figures_{};
};

}  // namespace ces
