// A damper's status: arrivals, latencies and reasons in; level, message and key-value pairs for /diagnostics out.
#ifndef HEALTH__HEALTH_HPP_
#define HEALTH__HEALTH_HPP_

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "core/damper.hpp"
#include "health/arrivals.hpp"
#include "health/episodes.hpp"
#include "health/latencies.hpp"
#include "health/load_meter.hpp"
#include "health/stillness.hpp"

namespace ces
{

enum class Level : std::uint8_t {OK, WARN, ERROR};  // as in diagnostic_msgs/msg/DiagnosticStatus

using Values = std::vector<std::pair<std::string, std::string>>;

struct Status
{
  Level level = Level::OK;
  std::string message;
  Values values;

  // Make it a warning with `remark` added to its message; an empty remark changes nothing.
  void add_remark(const std::string & remark)
  {
    if (remark.empty()) {return;}
    level = level == Level::OK ? Level::WARN : level;
    message += "; " + remark;
  }
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
  void note_change(Nanoseconds now);

  // Close a window of `elapsed_s` seconds.
  void roll(double elapsed_s, Load load);

  // The present status; `detail` is added to the reason. One status reports each ended episode.
  Status report(const std::string & detail);

private:
  std::vector<std::string> find_remarks() const;
  Values list_values() const;
  void add_episodes(Values & values) const;
  static void add_arrivals(Values & values, const std::string & name, const ArrivalFigures & figures);

  const Damper & damper_;
  Episodes episodes_;
  LatencyFigures latency_;
  Load load_;
  std::uint64_t samples_ = 0, estimates_ = 0, clamped_ = 0;  // before this window
  double rate_Hz_ = 0.0, withheld_ = 0.0, outside_ = 0.0;
  std::uint64_t reported_episodes_ = 0, reported_rests_ = 0;
};

}  // namespace ces

#endif  // HEALTH__HEALTH_HPP_
