#include "health/health.hpp"

#include <algorithm>

namespace ces
{
namespace
{

constexpr double OUTSIDE_WARN = 0.01;  // share of forces from inputs outside the envelope that gives a warning
constexpr double DROPPED_WARN = 0.01;  // share of lost positions that gives a warning

bool is_error(Reason reason)
{
  return reason == Reason::SILENT || reason == Reason::POSITION_NOT_FINITE || reason == Reason::NO_CURRENT ||
         reason == Reason::OFF_CLOCK || reason == Reason::UNBOUNDED;
}

double divide(std::uint64_t part, std::uint64_t whole)
{
  return whole ? static_cast<double>(part) / static_cast<double>(whole) : 0.0;
}

std::string percent(double share) {return format_number("%.1f%%", 100.0 * share);}

std::string milliseconds(double seconds) {return format_number("%.3f", 1e3 * seconds);}

// What became of the samples that are missing in a window, as the end of a sentence.
std::string describe_missing(const ArrivalFigures & figures)
{
  if (figures.overflowed) {
    return "missing, " + std::to_string(figures.overflowed) + " of them dropped by this node's queue: set input_depth higher";
  }
  if (!figures.lost) {return "missing: lost on the way, or the source paused";}
  return *figures.lost ? "missing, " + std::to_string(*figures.lost) + " of them lost on the way" :
         "missing: the source paused";
}

// What became of the samples that are missing in an input's stamps, as far as that is known.
void add_missing(Values & values, const std::string & name, const ArrivalFigures & figures)
{
  const auto describe = [&figures](std::int64_t count) {
      return figures.total_lost ? std::to_string(std::max(std::int64_t(0), count)) :
             "unknown: the middleware does not number the messages";
    };
  const auto lost = figures.total_lost.value_or(0);
  values.emplace_back(name + ": dropped, in this node's queue", std::to_string(figures.total_overflowed));
  values.emplace_back(name + ": dropped, lost on the way", describe(lost - figures.total_overflowed));
  values.emplace_back(name + ": dropped, not sent", describe(figures.total_dropped - lost));
}

const char * describe_outside()
{
  return Model::EXTRAPOLATES ? "of the forces extrapolated to inputs" : "of the forces from clamped inputs,";
}

// Reasons in the order of their texts.
std::vector<Reason> list_reasons()
{
  std::vector<Reason> reasons;
  for (std::size_t k = 0; k < REASON_TEXTS.size(); ++k) {reasons.push_back(static_cast<Reason>(k));}
  std::sort(
    reasons.begin(), reasons.end(),
    [](Reason one, Reason two) {return std::string(text_of(one)) < text_of(two);});
  return reasons;
}

}  // namespace

void Health::note_change(Nanoseconds now)
{
  const auto withheld = damper_.tally().withheld_samples();
  const auto reason = damper_.reason();
  if (reason == Reason::OK) {
    episodes_.end_episode(now, withheld);
  } else {
    episodes_.add_withheld(reason, now, reason == Reason::SILENT || withheld == 0 ? withheld : withheld - 1);
  }
}

void Health::roll(double elapsed_s, Load load)
{
  const auto & tally = damper_.tally();
  const auto samples = tally.samples - samples_, estimates = tally.estimates - estimates_;
  rate_Hz_ = elapsed_s > 0.0 ? static_cast<double>(samples) / elapsed_s : 0.0;
  withheld_ = samples ? 1.0 - divide(estimates, samples) : 0.0;
  outside_ = divide(tally.clamped - clamped_, estimates);
  samples_ = tally.samples;
  estimates_ = tally.estimates;
  clamped_ = tally.clamped;
  position.roll(elapsed_s);
  current.roll(elapsed_s);
  latency_ = latency.roll();
  load_ = load;
}

Status Health::report(const std::string & detail)
{
  const auto reason = damper_.reason();
  const auto remarks = find_remarks();
  reported_episodes_ = episodes_.total();
  reported_rests_ = stillness.count();
  Status status;
  if (reason == Reason::OK) {
    status.level = remarks.empty() ? Level::OK : Level::WARN;
    status.message = "estimating";
  } else {
    status.level = is_error(reason) ? Level::ERROR : Level::WARN;
    status.message = std::string("withholding: ") + text_of(reason) + (detail.empty() ? "" : ": " + detail);
  }
  for (const auto & remark : remarks) {status.message += "; " + remark;}
  status.values = list_values();
  return status;
}

std::vector<std::string> Health::find_remarks() const
{
  std::vector<std::string> remarks;
  const bool ok = damper_.reason() == Reason::OK;
  if (const auto fresh = episodes_.total() - reported_episodes_) {
    const auto & last = episodes_.newest(0);
    remarks.push_back(
      "recovered from " + last.describe_reasons() + " (" + format_number("%.2g", last.length_s) + " s)" +
      (fresh > 1 ? " and " + std::to_string(fresh - 1) + " more" : ""));
  }
  if (ok && withheld_ > 0.0) {remarks.push_back(percent(withheld_) + " withheld in the last second");}
  if (ok && outside_ >= OUTSIDE_WARN) {
    remarks.push_back(percent(outside_) + " " + describe_outside() + " outside what the model was identified on");
  }
  const auto rest = "the position has not changed for " + format_number("%.1f", stillness.last_s()) + " s";
  if (stillness.is_resting()) {
    remarks.push_back(rest + ": at rest, or its sensor is stuck");
  } else if (stillness.count() > reported_rests_) {
    remarks.push_back(rest + " and does now");
  }
  const auto & figures = position.figures();
  const auto all = static_cast<double>(figures.samples + figures.dropped);
  if (figures.dropped && static_cast<double>(figures.dropped) >= DROPPED_WARN * all) {
    remarks.push_back(percent(static_cast<double>(figures.dropped) / all) + " of the positions " + describe_missing(figures));
  }
  return remarks;
}

Values Health::list_values() const
{
  const auto & tally = damper_.tally();
  Values values{
    {"reason", text_of(damper_.reason())},
    {"rate [Hz]", format_number("%.1f", rate_Hz_)},
    {"age of the last position on arrival [s]", format_number("%.6f", to_s(damper_.age()))},
    {"share outside the envelope", format_number("%.4f", outside_)},
    {"inputs outside the envelope", std::string("are ") + Model::OUTSIDE},
    {"position samples", std::to_string(tally.samples)},
    {"forces estimated", std::to_string(tally.estimates)},
    {"messages without the field", std::to_string(tally.unreadable)}};
  for (const auto reason : list_reasons()) {
    if (const auto count = tally.withheld[reason]) {
      values.emplace_back(std::string("withheld: ") + text_of(reason), std::to_string(count));
    }
  }
  add_episodes(values);
  values.emplace_back("position has not changed, times", std::to_string(stillness.count()));
  if (stillness.count()) {
    values.emplace_back("position has not changed, last for [s]", format_number("%.3f", stillness.last_s()));
  }
  for (const auto & [name, time] : {
      std::pair{"p50", latency_.p50}, std::pair{"p99", latency_.p99}, std::pair{"max", latency_.max}})
  {
    values.emplace_back(
      std::string("latency from stamp to publish, ") + name + " [ms]",
      latency_.samples ? milliseconds(to_s(time)) : "none");
  }
  values.emplace_back("process load [% of a core]", format_number("%.1f", 100.0 * load_.process));
  values.emplace_back("executor load [% of a core]", format_number("%.1f", 100.0 * load_.executor));
  add_arrivals(values, "position", position.figures());
  add_arrivals(values, "current", current.figures());
  return values;
}

void Health::add_episodes(Values & values) const
{
  values.emplace_back("episodes of withholding", std::to_string(episodes_.total()));
  for (const auto reason : list_reasons()) {
    if (const auto & total = episodes_.by_reason()[reason]; total.count) {
      values.emplace_back(
        std::string("episodes: ") + text_of(reason),
        std::to_string(total.count) + ", " + format_number("%.3f", total.length_s) + " s in all");
    }
  }
  for (std::size_t back = 0; back < episodes_.kept(); ++back) {
    values.emplace_back("last episode " + std::to_string(back + 1), episodes_.newest(back).describe());
  }
}

void Health::add_arrivals(Values & values, const std::string & name, const ArrivalFigures & figures)
{
  if (!figures.total_samples) {return;}
  values.emplace_back(name + ": rate [Hz]", format_number("%.1f", figures.rate_Hz));
  values.emplace_back(name + ": age, mean [ms]", milliseconds(figures.mean_age_s));
  values.emplace_back(name + ": age, max [ms]", milliseconds(figures.max_age_s));
  values.emplace_back(name + ": jitter [ms]", milliseconds(figures.jitter_s));
  values.emplace_back(name + ": longest interval [ms]", milliseconds(figures.longest_s));
  values.emplace_back(name + ": longest burst", std::to_string(figures.burst));
  if (figures.has_dropped) {
    values.emplace_back(name + ": dropped", std::to_string(figures.total_dropped));
    add_missing(values, name, figures);
  }
  values.emplace_back(name + ": out of order", std::to_string(figures.total_out_of_order));
  values.emplace_back(name + ": duplicates", std::to_string(figures.total_duplicates));
  values.emplace_back(name + ": interruptions", std::to_string(figures.total_interruptions));
}

}  // namespace ces
