// A histogram of latencies: whole nanoseconds in, percentiles to 1.6 % and the maximum out.
//
// The classes are log-linear as in G. Tene's HdrHistogram: each power of two has 64 equal classes.
#ifndef HEALTH__LATENCIES_HPP_
#define HEALTH__LATENCIES_HPP_

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "core/numbers.hpp"

namespace ces
{

// One window: median, 99th percentile and maximum, 0 if it was empty, and the number of latencies.
struct LatencyFigures
{
  Nanoseconds p50 = 0, p99 = 0, max = 0;
  std::uint64_t samples = 0;
};

class Latencies
{
public:
  // Count a latency; a negative one, from different clocks, counts as zero.
  void take(Nanoseconds latency)
  {
    max_ = std::max(max_, latency);
    ++counts_[find_class(std::clamp(latency, Nanoseconds(0), MAX))];
  }

  // The figures of the window; begins a new one.
  LatencyFigures roll()
  {
    LatencyFigures figures;
    for (const auto count : counts_) {figures.samples += count;}
    figures.p50 = find_percentile(figures.samples, 50);
    figures.p99 = find_percentile(figures.samples, 99);
    figures.max = max_;
    counts_.fill(0);
    max_ = 0;
    return figures;
  }

private:
  static constexpr std::size_t PARTS_BITS = 6;
  static constexpr std::size_t WHOLE_BITS = PARTS_BITS + 1;  // smaller numbers have a class each
  static constexpr std::size_t MAX_BITS = 37;
  static constexpr Nanoseconds MAX = (Nanoseconds(1) << MAX_BITS) - 1;  // 137 s; the last class counts all longer ones
  static constexpr std::size_t CLASSES = (MAX_BITS - PARTS_BITS + 1) << PARTS_BITS;

  static std::size_t find_class(Nanoseconds latency)
  {
    std::size_t shift = 0;
    while ((latency >> shift) >= (Nanoseconds(1) << WHOLE_BITS)) {++shift;}
    return (shift << PARTS_BITS) + static_cast<std::size_t>(latency >> shift);
  }

  // The middle of the class that holds the smallest latency not exceeded by `percent` of all.
  Nanoseconds find_percentile(std::uint64_t samples, std::uint64_t percent) const
  {
    const std::uint64_t wanted = (samples * percent + 99) / 100;
    if (samples == 0) {return 0;}
    std::uint64_t seen = 0;
    std::size_t place = 0;
    while ((seen += counts_[place]) < wanted) {++place;}
    return std::min(find_middle(place), max_);
  }

  static Nanoseconds find_middle(std::size_t place)
  {
    const std::size_t shift = std::max(place >> PARTS_BITS, std::size_t(1)) - 1;
    return static_cast<Nanoseconds>(((place - (shift << PARTS_BITS)) << shift) + ((std::size_t(1) << shift) >> 1));
  }

  std::array<std::uint32_t, CLASSES> counts_{};
  Nanoseconds max_ = 0;
};

}  // namespace ces

#endif  // HEALTH__LATENCIES_HPP_
