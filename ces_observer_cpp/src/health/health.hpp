// A damper's health: arrivals, latencies and reasons in; tasks and key-value pairs for diagnostics out.
#pragma once

#include <map>

#include "core/damper.hpp"
#include "health/arrivals.hpp"
#include "health/process.hpp"

namespace ces {

using diagnostic_msgs::msg::DiagnosticStatus;

// A task of /diagnostics: each remark makes it a warning.
struct Task {
  std::uint8_t level;
  std::string words;
  std::vector<std::string> remarks = {};

  void add(bool is_due, const std::string & remark) {if (is_due) {remarks.push_back(remark);}}

  // Write level and message.
  void summarise(Status & status) const {
    status.summary(
      std::max(level, remarks.empty() ? DiagnosticStatus::OK : DiagnosticStatus::WARN),
      words + (remarks.empty() ? "" : "; " + join(remarks, "; ")));
  }
};

// The log's lines on the reason: one as it changes; while it flickers none, and one when it is quiet.
class ReasonLog {
public:
  // The line to log at `now` of the steady clock, empty for none; `changes` of the reason and samples `withheld` are
  // counted since the start.
  std::string find_line(
    Nanoseconds now, const std::string & reason, std::string message, std::int64_t changes, std::int64_t withheld) {
    const bool is_quiet = now - changed_ >= SECOND;
    if (reason != reason_ || changes != changes_) {
      reason_ = reason;
      changes_ = changes;
      changed_ = now;
      is_due_ = true;
    }
    if (!is_due_ || !is_quiet) {return "";}
    const auto count = changes - logged_, samples = withheld - withheld_;
    logged_ = changes;
    withheld_ = withheld;
    is_due_ = false;
    if (count > 1) {message += "; " + std::to_string(count) + " changes since the last line";}
    return samples > 1 ? message + "; " + std::to_string(samples) + " samples withheld" : message;
  }

private:
  std::string reason_;
  std::int64_t changes_ = 0, logged_ = 0, withheld_ = 0;  // the last two: at the last line
  Nanoseconds changed_ = -SECOND;
  bool is_due_ = false;
};

// Episodes of withholding: from a withheld force to the next published one, with reasons and counts.
class Episodes {
public:
  // Add a reason for withholding; `withheld_before` counts the samples withheld before this one.
  void add_withheld(Reason reason, Nanoseconds now, std::uint64_t withheld_before) {
    if (reasons_.empty()) {
      start_ = now;
      withheld_ = withheld_before;
    }
    const bool is_new = std::find(reasons_.begin(), reasons_.end(), text_of(reason)) == reasons_.end();
    if (is_new && reasons_.size() < MAX_REASONS) {reasons_.push_back(text_of(reason));}
  }

  // End the episode, if there is one; `withheld` counts the samples withheld so far.
  // One that began at 0, before the first /clock of simulated time, is taken to begin now.
  void end_episode(Nanoseconds now, std::uint64_t withheld) {
    if (reasons_.empty()) {return;}
    if (start_ == 0) {start_ = now;}
    const auto length_s = to_s(std::max(Nanoseconds(0), now - start_));
    const auto names = join(reasons_, ", then ");
    char start[40];
    std::snprintf(start, sizeof start, "%lld.%03lld s, for ", static_cast<long long>(start_ / SECOND),
      static_cast<long long>(start_ / 1'000'000 % 1000));
    last = start + format_number("%.3f s: ", length_s) + names + " (" + std::to_string(withheld - withheld_) +
      " samples withheld)";
    newest = names + " (" + format_number("%.2g", length_s) + " s)";
    ++total;
    reasons_.clear();
  }

  std::uint64_t total = 0;  // ended ones
  std::string last = "none", newest;  // the last of them in words, and its reasons and length

private:
  static constexpr std::size_t MAX_REASONS = 4;  // of one episode listed by name

  std::vector<std::string> reasons_;  // of the present episode
  Nanoseconds start_ = 0;  // by the node's clock
  std::uint64_t withheld_ = 0;  // before it
};

// Rests: how long the position has had exactly the same value, because the vehicle rests or the sensor is stuck.
class Stillness {
public:
  // Rests of at least this long [s] by the positions' stamps count; with 0 there are none.
  void set_warn(double warn_s) {warn_ = to_ns(warn_s);}

  // Add a position sample [m]; NaN ends a rest.
  void take(Nanoseconds stamp, double position_m) {
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
class Latencies {
public:
  // Count a latency; a negative one, from different clocks, counts as zero.
  void take(Nanoseconds latency) {latencies_[count_++ % CAPACITY] = std::max(Nanoseconds(0), latency);}

  // Close the window: the values are now those of its latencies.
  void roll() {
    const auto size = std::min(std::exchange(count_, 0), CAPACITY);
    std::sort(latencies_.begin(), latencies_.begin() + static_cast<std::ptrdiff_t>(size));
    for (std::size_t k = 0; k < PERCENTS.size(); ++k) {
      const auto place = (size * PERCENTS[k] + 99) / 100;
      texts_[k] = size ? format_number(figures::LATENCY.form, 1e3 * to_s(latencies_[place - 1])) : "none";
    }
  }

  void add_values(Status & status) const {
    for (std::size_t k = 0; k < PERCENTS.size(); ++k) {
      const auto name = PERCENTS[k] == 100 ? "max" : "p" + std::to_string(PERCENTS[k]);
      std::string key = figures::LATENCY.key;
      for (const auto & word : {std::string("publish"), name}) {key.replace(key.find("{}"), 2, word);}
      status.add(key, texts_[k]);
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
class Health {
public:
  explicit Health(const Damper & damper)
  : damper_(damper) {}

  // The node calls `take` of these with each sample.
  Arrivals position, current;
  Stillness stillness;
  Latencies latency;

  // Record a change of the damper's reason; an episode includes its first withheld sample.
  void note_change(Nanoseconds now) {
    ++changes_;
    const auto withheld = damper_.tally().withheld_samples();
    const auto reason = damper_.reason();
    if (reason == Reason::OK) {
      episodes_.end_episode(now, withheld);
    } else {
      episodes_.add_withheld(reason, now, reason == Reason::SILENT || withheld == 0 ? withheld : withheld - 1);
    }
  }

  // Close a window of `elapsed_s` seconds.
  void roll(double elapsed_s) {
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
    is_rolled_ = true;
    recent_jump_ = jumps_ > rolled_jumps_ ? jump_ : "";
    rolled_jumps_ = jumps_;
  }

  // A jump of the node's time.
  void note_jump(const std::string & what) {
    ++jumps_;
    jump_ = what;
    position.restart_ages();
    current.restart_ages();
  }

  // The changes of the damper's reason, and the samples withheld, since the start.
  std::int64_t changes() const {return changes_;}
  std::int64_t withheld() const {return static_cast<std::int64_t>(damper_.tally().withheld_samples());}

  // The task `health`; `detail` is added to the reason. One message reports each ended episode.
  Task make_health_task(const std::string & detail) {
    const auto reason = damper_.reason();
    const bool ok = reason == Reason::OK, is_error = std::count(std::begin(ERRORS), std::end(ERRORS), reason);
    Task task{DiagnosticStatus::OK, remarks::ESTIMATING};
    if (!ok) {
      task = {is_error ? DiagnosticStatus::ERROR : DiagnosticStatus::WARN,
        std::string(remarks::WITHHOLDING) + text_of(reason) + (detail.empty() ? "" : ": " + detail)};
    }
    const auto fresh = episodes_.total - std::exchange(reported_episodes_, episodes_.total);
    const auto more = fresh > 1 ? format_number(remarks::MORE_EPISODES, static_cast<double>(fresh - 1)) : "";
    task.add(fresh > 0, remarks::RECOVERED + episodes_.newest + more);
    task.add(ok && withheld_ > 0.0, format_number(remarks::WITHHELD, 100.0 * withheld_));
    const auto outside = damper_.model().extrapolates ? remarks::EXTRAPOLATED : remarks::CLAMPED;
    task.add(ok && outside_ >= limits::OUTSIDE, format_number(outside, 100.0 * outside_));
    task.add(ok && held_ >= limits::OUTSIDE, format_number(remarks::HELD, 100.0 * held_));
    const bool is_over = stillness.count() > std::exchange(reported_rests_, stillness.count());
    task.add(stillness.is_resting(), format_number(remarks::RESTS, stillness.last_s()));
    task.add(!stillness.is_resting() && is_over, format_number(remarks::RESTED, stillness.last_s()));
    return task;
  }

  // The task `frequency`; `mismatch` is what else is published on the topics.
  Task make_frequency_task(const std::string & mismatch) const {
    const auto & figures = position.figures();
    Task task{DiagnosticStatus::OK, format_number(remarks::POSITION_RATE, figures.rate_Hz)};
    if (!is_rolled_ || !figures.samples) {
      task.level = is_rolled_ ? DiagnosticStatus::ERROR : DiagnosticStatus::OK;
      task.words = is_rolled_ ? remarks::NO_POSITION : remarks::NOT_MEASURED;
    } else if (!damper_.current().is_constant()) {
      task.words += format_number(remarks::CURRENT_RATE, current.figures().rate_Hz);
    }
    const auto share = static_cast<double>(figures.dropped) / static_cast<double>(figures.samples + figures.dropped);
    task.add(
      figures.samples && figures.dropped && share >= limits::DROPPED,
      format_number(remarks::MISSING, 100.0 * share) + describe_missing(figures));
    task.add(!mismatch.empty(), mismatch);
    return task;
  }

  // The task `time stamps`.
  Task make_stamps_task() const {
    const auto & figures = position.figures();
    Task task{DiagnosticStatus::OK, !is_rolled_ ? remarks::NOT_MEASURED :
      !figures.samples ? remarks::NO_RECENT_POSITION :
      !figures.has_dropped ? remarks::NO_STAMP : format_number(remarks::ARRIVAL, 1e3 * figures.mean_age_s)};
    const bool is_ahead = figures.has_dropped && figures.samples && figures.mean_age_s < -limits::AHEAD_S;
    task.add(is_ahead, remarks::AHEAD);
    const auto & other = current.figures();
    const auto apart_s = figures.usual_age_s - other.usual_age_s;
    const bool is_apart = std::abs(apart_s) > (other.has_dropped ? limits::LATE_S : limits::OFFSET_S);
    task.add(
      figures.has_dropped && figures.samples && other.samples && is_apart, format_number(remarks::APART, apart_s));
    task.add(figures.repeats, format_number(remarks::REPEATS, static_cast<double>(figures.repeats)));
    task.add(
      figures.interruptions,
      format_number(remarks::INTERRUPTIONS, static_cast<double>(figures.interruptions)));
    task.add(!recent_jump_.empty(), recent_jump_);
    return task;
  }

  // Write all key-value pairs.
  void add_values(Status & status) const {
    const auto & tally = damper_.tally();
    const auto & model = damper_.model();
    add(status, figures::REASON, text_of(damper_.reason()));
    add(status, figures::RATE, rate_Hz_);
    add(status, figures::AGE, to_s(damper_.age()));
    add(status, figures::WITHHELD_SHARE, 100.0 * withheld_);
    add(status, figures::OUTSIDE_SHARE, outside_);
    add(status, figures::OUTSIDE, model.outside);
    add(status, figures::SAMPLES, tally.samples);
    add(status, figures::ESTIMATED, tally.estimates);
    if (model.delay_ticks) {add(status, figures::LATE, tally.late);}
    if (tally.held) {add(status, figures::HELD, tally.held);}
    add(status, figures::UNREADABLE, tally.unreadable);
    std::map<std::string, std::uint64_t> withheld;  // in the order of the reasons' texts
    for (std::size_t k = 0; k < tally.withheld.size(); ++k) {withheld[REASON_TEXTS[k]] = tally.withheld[k];}
    for (const auto & [reason, count] : withheld) {
      if (count) {add(status, figures::WITHHELD, count, reason);}
    }
    add(status, figures::EPISODES, episodes_.total);
    add(status, figures::LAST_EPISODE, episodes_.last);
    add(status, figures::RESTS, stillness.count());
    if (stillness.count()) {add(status, figures::LAST_REST, stillness.last_s());}
    latency.add_values(status);
    load_.add_values(status);
    add_arrivals(status, "position", position.figures());
    add_arrivals(status, "current", current.figures());
    if (position.figures().has_dropped) {add(status, figures::ALL_DROPPED, position.figures().total_dropped);}
    add(status, figures::JUMPS, std::to_string(jumps_) + ", the last: " + jump_);
  }

private:
  // What became of the samples that are missing in a window, as the end of a sentence.
  static std::string describe_missing(const ArrivalFigures & figures) {
    if (figures.overflowed) {
      return format_number(remarks::MISSING_IN_QUEUE, static_cast<double>(figures.overflowed));
    }
    if (!figures.lost) {return remarks::MISSING_UNKNOWN;}
    return *figures.lost ? format_number(remarks::MISSING_ON_THE_WAY, static_cast<double>(*figures.lost)) :
           remarks::MISSING_PAUSED;
  }

  static void add_arrivals(Status & status, const char * name, const ArrivalFigures & arrivals) {
    if (!arrivals.total_samples) {return;}
    add(status, figures::STREAM_RATE, arrivals.rate_Hz, name);
    add(status, figures::MEAN_AGE, 1e3 * arrivals.mean_age_s, name);
    add(status, figures::MAX_AGE, 1e3 * arrivals.max_age_s, name);
    add(status, figures::JITTER, 1e3 * arrivals.jitter_s, name);
    if (arrivals.has_dropped) {
      const auto describe = [&arrivals](std::int64_t count) {
          return arrivals.total_lost ? std::to_string(std::max(std::int64_t(0), count)) : remarks::NOT_NUMBERED;
        };
      const auto lost = arrivals.total_lost.value_or(0);
      add(status, figures::DROPPED, arrivals.total_dropped, name);
      add(status, figures::DROPPED_IN_QUEUE, arrivals.total_overflowed, name);
      add(status, figures::DROPPED_ON_THE_WAY, describe(lost - arrivals.total_overflowed), name);
      add(status, figures::NOT_SENT, describe(arrivals.total_dropped - lost), name);
    }
    add(status, figures::OUT_OF_ORDER, arrivals.total_out_of_order, name);
    add(status, figures::DUPLICATES, arrivals.total_duplicates, name);
    add(status, figures::INTERRUPTIONS, arrivals.total_interruptions, name);
  }

  const Damper & damper_;
  Episodes episodes_;
  LoadMeter load_;
  Tally before_;  // before this window
  double rate_Hz_ = 0.0, withheld_ = 0.0, outside_ = 0.0, held_ = 0.0;
  std::uint64_t reported_episodes_ = 0, reported_rests_ = 0;
  std::int64_t changes_ = 0;
  std::uint64_t jumps_ = 0, rolled_jumps_ = 0;
  std::string jump_ = "none", recent_jump_;
  bool is_rolled_ = false;
};

}  // namespace ces
