#include "health/episodes.hpp"

#include <algorithm>
#include <cinttypes>

namespace ces
{

std::string Episode::describe_reasons() const
{
  std::string text;
  for (std::size_t k = 0; k < reason_count; ++k) {text += std::string(k ? ", then " : "") + text_of(reasons[k]);}
  return text;
}

std::string Episode::describe() const
{
  char text[400];
  std::snprintf(
    text, sizeof text, "%" PRId64 ".%03" PRId64 " s, for %.3f s: %s (%" PRIu64 " samples withheld)", start / SECOND,
    start / 1'000'000 % 1000, length_s, describe_reasons().c_str(), withheld);
  return text;
}

void Episodes::add_withheld(Reason reason, Nanoseconds now, std::uint64_t withheld_before)
{
  if (present_.reason_count == 0) {
    present_.start = now;
    present_.withheld = withheld_before;
  }
  const auto end = present_.reasons.begin() + static_cast<std::ptrdiff_t>(present_.reason_count);
  if (std::find(present_.reasons.begin(), end, reason) == end && present_.reason_count < Episode::MAX_REASONS) {
    present_.reasons[present_.reason_count++] = reason;
  }
}

void Episodes::end_episode(Nanoseconds now, std::uint64_t withheld)
{
  if (present_.reason_count == 0) {return;}
  if (present_.start == 0) {present_.start = now;}
  present_.length_s = to_s(std::max(Nanoseconds(0), now - present_.start));
  present_.withheld = withheld - present_.withheld;
  last_[total_++ % MAX_EPISODES] = present_;
  auto & total = by_reason_[present_.reasons[0]];
  ++total.count;
  total.length_s += present_.length_s;
  present_ = Episode();
}

}  // namespace ces
