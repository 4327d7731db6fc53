// A damper's status: arrivals, latencies and reasons in; level, message and key-value pairs for /diagnostics out.
#pragma once

#include <deque>
#include <map>

#include <diagnostic_updater/diagnostic_status_wrapper.hpp>

#include "core/damper.hpp"
#include "health/arrivals.hpp"
#include "health/process.hpp"

namespace ces
{

// Episodes of withholding: from a withheld force to the next published one, with reasons and counts.
class Episodes
{
public:
  // Add a reason for withholding; `withheld_before` counts the samples withheld before this one.
  void add_withheld(Reason reason, Nanoseconds now, std::uint64_t withheld_before)
  {
    if (reasons_.empty()) {
      start_ = now;
      withheld_ = withheld_before;
    }
    const bool is_new = std::find(reasons_.begin(), reasons_.end(), text_of(reason)) == reasons_.end();
    if (is_new && reasons_.size() < MAX_REASONS) {reasons_.push_back(text_of(reason));}
  }

  // End the episode, if there is one; `withheld` counts the samples withheld so far.
  // One that began at 0, before the first /clock of simulated time, is taken to begin now.
  void end_episode(Nanoseconds now, std::uint64_t withheld)
  {
    if (reasons_.empty()) {return;}
    if (start_ == 0) {start_ = now;}
    const auto length_s = to_s(std::max(Nanoseconds(0), now - start_));
    const auto names = join(reasons_, ", then ");
    auto milliseconds = std::to_string(start_ / 1'000'000 % 1000);
    milliseconds.insert(0, 3 - milliseconds.size(), '0');
    last_.push_front(
      std::to_string(start_ / SECOND) + "." + milliseconds + " s, for " + format_number("%.3f", length_s) + " s: " +
      names + " (" + std::to_string(withheld - withheld_) + " samples withheld)");
    if (last_.size() > MAX_EPISODES) {last_.pop_back();}
    newest_ = names + " (" + format_number("%.2g", length_s) + " s)";
    auto & [count, sum_s] = by_reason_[reasons_[0]];
    ++count;
    sum_s += length_s;
    ++total_;
    reasons_.clear();
  }

  std::uint64_t total() const {return total_;}

  // The reasons of the newest ended episode, and its length.
  const std::string & newest() const {return newest_;}

  void add_values(diagnostic_updater::DiagnosticStatusWrapper & status) const
  {
    status.add("episodes of withholding", total_);
    for (const auto & [reason, total] : by_reason_) {
      status.add("episodes: " + reason, std::to_string(total.first) + format_number(", %.3f s in all", total.second));
    }
    for (std::size_t k = 0; k < last_.size(); ++k) {status.add("last episode " + std::to_string(k + 1), last_[k]);}
  }

private:
  static constexpr std::size_t MAX_EPISODES = 10;  // ended episodes kept one by one; the totals count all
  static constexpr std::size_t MAX_REASONS = 4;  // of one episode listed by name

  std::vector<std::string> reasons_;  // of the present episode
  Nanoseconds start_ = 0;  // by the node's clock
  std::uint64_t withheld_ = 0;  // before it
  std::deque<std::string> last_;  // the ended ones, newest first
  std::string newest_;
  std::map<std::string, std::pair<std::uint64_t, double>> by_reason_;  // count and length [s], by the first reason
  std::uint64_t total_ = 0;
};

// Rests: how long the position has had exactly the same value, because the vehicle rests or the sensor is stuck.
class Stillness
{
public:
  // Rests of at least this long [s] by the positions' stamps count; with 0 there are none.
  void set_warn(double warn_s) {warn_ = to_ns(warn_s);}

  // Add a position sample [m]; NaN ends a rest.
  void take(Nanoseconds stamp, double position_m)
  {
    if (position_m != position_m_ || stamp < since_) {
      position_m_ = position_m;
      since_ = stamp;
      resting_ = false;
    } else if (resting_ || (warn_ > 0 && stamp - since_ >= warn_)) {
      count_ += !resting_;
      resting_ = true;
      last_s_ = to_s(stamp - since_);
    }
  }

  bool is_resting() const {return resting_;}
  std::uint64_t count() const {return count_;}
  double last_s() const {return last_s_;}  // length of the last rest

private:
  Nanoseconds warn_ = SECOND, since_ = 0;
  double position_m_ = NOT_A_NUMBER, last_s_ = 0.0;
  std::uint64_t count_ = 0;
  bool resting_ = false;
};

// The newest latencies of a window, and their percentiles; memory does not grow.
class Latencies
{
public:
  // Count a latency; a negative one, from different clocks, counts as zero.
  void take(Nanoseconds latency) {latencies_[count_++ % latencies_.size()] = std::max(Nanoseconds(0), latency);}

  // Close the window: the values are now those of its latencies.
  void roll()
  {
    const auto end = latencies_.begin() + static_cast<std::ptrdiff_t>(std::min(count_, latencies_.size()));
    std::sort(latencies_.begin(), end);
    const auto size = static_cast<std::size_t>(end - latencies_.begin());
    for (std::size_t k = 0; k < PERCENTS.size(); ++k) {
      const auto milliseconds = [&] {return 1e3 * to_s(latencies_[(size * PERCENTS[k] + 99) / 100 - 1]);};
      texts_[k] = size ? format_number("%.3f", milliseconds()) : "none";
    }
    count_ = 0;
  }

  void add_values(diagnostic_updater::DiagnosticStatusWrapper & status) const
  {
    for (std::size_t k = 0; k < PERCENTS.size(); ++k) {
      const auto name = PERCENTS[k] == 100 ? "max" : "p" + std::to_string(PERCENTS[k]);
      status.add("latency from stamp to publish, " + name + " [ms]", texts_[k]);
    }
  }

private:
  static constexpr std::size_t CAPACITY = 20'000;  // more than a second's samples
  static constexpr std::array<std::size_t, 3> PERCENTS{50, 99, 100};

  std::vector<Nanoseconds> latencies_ = std::vector<Nanoseconds>(CAPACITY);
  std::size_t count_ = 0;
  std::array<std::string, 3> texts_{"none", "none", "none"};
};

// Rates, shares and latencies are of the last window that `roll` closed. Times are those of the node's clock.
class Health
{
public:
  explicit Health(const Damper & damper)
  : damper_(damper) {}

  // The node calls `take` of these with each sample.
  Arrivals position, current;
  Stillness stillness;
  Latencies latency;

  // Record a change of the damper's reason; an episode includes its first withheld sample.
  void note_change(Nanoseconds now)
  {
    const auto withheld = damper_.tally().withheld_samples();
    const auto reason = damper_.reason();
    if (reason == Reason::OK) {
      episodes_.end_episode(now, withheld);
    } else {
      episodes_.add_withheld(reason, now, reason == Reason::SILENT || withheld == 0 ? withheld : withheld - 1);
    }
  }

  // Close a window of `elapsed_s` seconds.
  void roll(double elapsed_s)
  {
    const auto & now = damper_.tally();
    const auto samples = static_cast<double>(now.samples - before_.samples);
    const auto estimates = static_cast<double>(now.estimates - before_.estimates);
    rate_Hz_ = elapsed_s > 0.0 ? samples / elapsed_s : 0.0;
    withheld_ = samples > 0.0 ? 1.0 - estimates / samples : 0.0;
    outside_ = estimates > 0.0 ? static_cast<double>(now.clamped - before_.clamped) / estimates : 0.0;
    held_ = estimates > 0.0 ? static_cast<double>(now.held - before_.held) / estimates : 0.0;
    before_ = now;
    position.roll(elapsed_s);
    current.roll(elapsed_s);
    latency.roll();
    load_.roll();
  }

  // Write the present status; `detail` is added to the reason. One status reports each ended episode.
  void report(diagnostic_updater::DiagnosticStatusWrapper & status, const std::string & detail)
  {
    using diagnostic_msgs::msg::DiagnosticStatus;
    const auto reason = damper_.reason();
    const auto remarks = find_remarks();
    reported_episodes_ = episodes_.total();
    reported_rests_ = stillness.count();
    if (reason == Reason::OK) {
      status.summary(remarks.empty() ? DiagnosticStatus::OK : DiagnosticStatus::WARN, "estimating");
    } else {
      const bool is_error = std::count(std::begin(ERRORS), std::end(ERRORS), reason);
      status.summary(
        is_error ? DiagnosticStatus::ERROR : DiagnosticStatus::WARN,
        std::string("withholding: ") + text_of(reason) + (detail.empty() ? "" : ": " + detail));
    }
    for (const auto & remark : remarks) {status.message += "; " + remark;}
    add_values(status);
  }

private:
  static constexpr double OUTSIDE_WARN = 0.01;  // share of forces from inputs outside the envelope, or held at its own, for a warning
  static constexpr double DROPPED_WARN = 0.01;  // share of lost positions for a warning
  static constexpr Reason ERRORS[] = {
    Reason::SILENT, Reason::POSITION_NOT_FINITE, Reason::NO_CURRENT, Reason::OFF_CLOCK, Reason::UNBOUNDED,
    Reason::BEYOND_STROKE};

  std::vector<std::string> find_remarks() const
  {
    std::vector<std::string> remarks;
    const bool ok = damper_.reason() == Reason::OK;
    if (const auto fresh = episodes_.total() - reported_episodes_) {
      remarks.push_back(
        "recovered from " + episodes_.newest() + (fresh > 1 ? " and " + std::to_string(fresh - 1) + " more" : ""));
    }
    if (ok && withheld_ > 0.0) {
      remarks.push_back(format_number("%.1f%% withheld in the last second", 100.0 * withheld_));
    }
    if (ok && outside_ >= OUTSIDE_WARN) {
      remarks.push_back(
        format_number("%.1f%% of the forces ", 100.0 * outside_) +
        (Model::EXTRAPOLATES ? "extrapolated to inputs" : "from clamped inputs,") +
        " outside what the model was identified on");
    }
    if (ok && held_ >= OUTSIDE_WARN) {
      remarks.push_back(format_number("%.1f%% of the forces held at the force envelope", 100.0 * held_));
    }
    const auto rest = format_number("the position has not changed for %.1f s", stillness.last_s());
    if (stillness.is_resting()) {
      remarks.push_back(rest + ": at rest, or its sensor is stuck");
    } else if (stillness.count() > reported_rests_) {
      remarks.push_back(rest + " and does now");
    }
    const auto & figures = position.figures();
    const auto share = static_cast<double>(figures.dropped) / static_cast<double>(figures.samples + figures.dropped);
    if (figures.dropped && share >= DROPPED_WARN) {
      remarks.push_back(format_number("%.1f%% of the positions missing", 100.0 * share) + describe_missing(figures));
    }
    return remarks;
  }

  // What became of the samples that are missing in a window, as the end of a sentence.
  static std::string describe_missing(const ArrivalFigures & figures)
  {
    if (figures.overflowed) {
      return ", " + std::to_string(figures.overflowed) + " of them dropped by this node's queue: set input_depth higher";
    }
    if (!figures.lost) {return ": lost on the way, or the source paused";}
    return *figures.lost ? ", " + std::to_string(*figures.lost) + " of them lost on the way" : ": the source paused";
  }

  void add_values(diagnostic_updater::DiagnosticStatusWrapper & status) const
  {
    const auto & tally = damper_.tally();
    status.add("reason", text_of(damper_.reason()));
    status.addf("rate [Hz]", "%.1f", rate_Hz_);
    status.addf("age of the last position on arrival [s]", "%.6f", to_s(damper_.age()));
    status.addf("share outside the envelope", "%.4f", outside_);
    status.addf("inputs outside the envelope", "are %s", Model::OUTSIDE);
    status.add("position samples", tally.samples);
    status.add("forces estimated", tally.estimates);
    if (Model::DELAY_TICKS) {status.add("delayed forces estimated", tally.late);}
    if (tally.held) {status.add("forces held at the force envelope", tally.held);}
    status.add("messages without the field", tally.unreadable);
    std::map<std::string, std::uint64_t> withheld;  // in the order of the reasons' texts
    for (std::size_t k = 0; k < tally.withheld.size(); ++k) {withheld[REASON_TEXTS[k]] = tally.withheld[k];}
    for (const auto & [reason, count] : withheld) {
      if (count) {status.add("withheld: " + reason, count);}
    }
    episodes_.add_values(status);
    status.add("position has not changed, times", stillness.count());
    if (stillness.count()) {status.addf("position has not changed, last for [s]", "%.3f", stillness.last_s());}
    latency.add_values(status);
    load_.add_values(status);
    add_arrivals(status, "position: ", position.figures());
    add_arrivals(status, "current: ", current.figures());
  }

  static void add_arrivals(
    diagnostic_updater::DiagnosticStatusWrapper & status, const std::string & name, const ArrivalFigures & figures)
  {
    if (!figures.total_samples) {return;}
    status.addf(name + "rate [Hz]", "%.1f", figures.rate_Hz);
    status.addf(name + "age, mean [ms]", "%.3f", 1e3 * figures.mean_age_s);
    status.addf(name + "age, max [ms]", "%.3f", 1e3 * figures.max_age_s);
    status.addf(name + "jitter [ms]", "%.3f", 1e3 * figures.jitter_s);
    status.addf(name + "longest interval [ms]", "%.3f", 1e3 * figures.longest_s);
    status.add(name + "longest burst", figures.burst);
    if (figures.has_dropped) {
      const auto describe = [&figures](std::int64_t count) {
          return figures.total_lost ? std::to_string(std::max(std::int64_t(0), count)) :
                 "unknown: the middleware does not number the messages";
        };
      const auto lost = figures.total_lost.value_or(0);
      status.add(name + "dropped", figures.total_dropped);
      status.add(name + "dropped, in this node's queue", figures.total_overflowed);
      status.add(name + "dropped, lost on the way", describe(lost - figures.total_overflowed));
      status.add(name + "dropped, not sent", describe(figures.total_dropped - lost));
    }
    status.add(name + "out of order", figures.total_out_of_order);
    status.add(name + "duplicates", figures.total_duplicates);
    status.add(name + "interruptions", figures.total_interruptions);
  }

  const Damper & damper_;
  Episodes episodes_;
  LoadMeter load_;
  Tally before_;  // before this window
  double rate_Hz_ = 0.0, withheld_ = 0.0, outside_ = 0.0, held_ = 0.0;
  std::uint64_t reported_episodes_ = 0, reported_rests_ = 0;
};

}  // namespace ces
