#include "health/arrivals.hpp"

#include <algorithm>
#include <cstdlib>
#include <numeric>

namespace ces
{
namespace
{

constexpr Nanoseconds BACK = 50'000'000, BACK_PERIODS = 20;  // a stamp further back than both: clock set back, not late
constexpr Nanoseconds SILENCE = SECOND, SILENCE_PERIODS = 10;  // longer than both: silence, not lost messages
constexpr double MAX_LOST_SHARE = 0.5;  // of messages while learning; a period that implies more is rejected

std::int64_t count_periods(Nanoseconds step, double period)
{
  return static_cast<std::int64_t>(std::nearbyint(static_cast<double>(step) / period));
}

}  // namespace

void Arrivals::roll(double elapsed_s)
{
  if (usual_ != streak_at_) {count_pending();}
  end_run();
  missing_ = std::max(missing_, late_);
  const auto total = usual_ + rare_, samples = total - before_;
  const auto spread = find_spread();
  const auto dropped = missing_ - late_;
  ArrivalFigures next;
  next.samples = samples;
  next.total_samples = total;
  next.rate_Hz = elapsed_s > 0.0 ? static_cast<double>(samples) / elapsed_s : 0.0;
  next.mean_age_s = samples ? age_sum_ / static_cast<double>(samples) * 1e-9 : 0.0;
  next.max_age_s = samples ? to_s(max_age_) : 0.0;
  next.jitter_s = spread.jitter * 1e-9;
  next.longest_s = to_s(longest_);
  next.burst = samples ? max_run_ + 1 : 0;
  next.has_dropped = stamped_;
  next.dropped = stamped_ ? std::max(std::int64_t(0), dropped - figures_.total_dropped) : 0;
  next.total_dropped = stamped_ ? dropped : 0;
  if (losses_ != nullptr) {
    next.total_lost = losses_->lost();
    if (next.total_lost) {next.lost = *next.total_lost - figures_.total_lost.value_or(0);}
    next.total_overflowed = losses_->overflowed();
    next.overflowed = next.total_overflowed - figures_.total_overflowed;
  }
  next.total_out_of_order = late_;
  next.total_duplicates = duplicates_;
  next.total_interruptions = interruptions_;
  if (samples) {  // a window with a stall is none of usual ages
    const auto age = figures_.samples ? std::min(figures_.mean_age_s, next.mean_age_s) : next.mean_age_s;
    usual_age_ = static_cast<Nanoseconds>(age * 1e9);
  }
  figures_ = next;
  if (period_ != 0) {set_period(static_cast<double>(period_) + spread.mean);}
  before_ = total;
  age_sum_ = 0.0;
  longest_ = 0;
  max_run_ = 0;
  max_age_ = std::numeric_limits<Nanoseconds>::min();
}

// Mean deviation from the period and standard deviation of the usual intervals [ns].
Arrivals::Spread Arrivals::find_spread() const
{
  const auto count = static_cast<double>(usual_ - unmeasured_);
  if (count <= 0.0) {return {0.0, 0.0};}
  const double mean = deviation_ / count;
  return {mean, std::sqrt(std::max(0.0, deviation2_ / count - mean * mean))};
}

// Count a message whose stamp is not about one period after the newest.
void Arrivals::take_rare(Nanoseconds stamp, Nanoseconds step, Nanoseconds now)
{
  ++rare_;
  const auto waited = now - stamp - usual_age_;
  if (usual_ + rare_ == 1) {
    newest_ = stamp;
  } else if (step == 0) {
    duplicates_ += stamped_;
  } else if (step < 0 && step >= -std::max(BACK, BACK_PERIODS * period_)) {
    ++late_;
  } else {
    newest_ = stamp;
    const auto missing = period_ ? count_periods(step, static_cast<double>(period_)) - 1 : 0;
    const bool overflowed = losses_ != nullptr && losses_->take_gap(missing, waited, period_);
    if (overflowed || (step > 0 && step <= std::max(SILENCE, SILENCE_PERIODS * period_))) {
      longest_ = std::max(longest_, step);
      take_unusual(step);
    } else {
      ++interruptions_;
    }
  }
}

// Learn from an interval, or count the messages missing in it; a short one cancels a long one.
void Arrivals::take_unusual(Nanoseconds step)
{
  if (period_ == 0) {
    learn(step);
    return;
  }
  if (usual_ != streak_at_) {count_pending();}
  pending_ += count_periods(step, static_cast<double>(period_)) - 1;
  if (++streak_ < static_cast<std::int64_t>(LEARN)) {return;}
  if (std::llabs(pending_) > static_cast<std::int64_t>(LEARN / 2)) {  // nothing was lost: the rate has changed
    learnt_ = 0;
    pending_ = streak_ = 0;
    set_period(0.0);
  } else {
    count_pending();
  }
}

// Count the pending messages: usual intervals have ended the row of unusual ones.
void Arrivals::count_pending()
{
  missing_ += pending_;
  pending_ = streak_ = 0;
  streak_at_ = usual_;
}

void Arrivals::learn(Nanoseconds step)
{
  steps_[learnt_++ % LEARN] = step;
  if (learnt_ < LEARN) {return;}
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
void Arrivals::set_period(double period)
{
  period_ = static_cast<Nanoseconds>(std::nearbyint(period));
  short_ = static_cast<Nanoseconds>(std::nearbyint(0.5 * period));
  long_ = static_cast<Nanoseconds>(std::nearbyint(1.5 * period));
  close_ = static_cast<Nanoseconds>(std::nearbyint(0.25 * period));
  deviation_ = deviation2_ = 0.0;
  unmeasured_ = streak_at_ = usual_;
}

}  // namespace ces
