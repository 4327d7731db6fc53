// Episodes of withholding: from a withheld force to the next published one, with reasons and counts.
#ifndef HEALTH__EPISODES_HPP_
#define HEALTH__EPISODES_HPP_

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/numbers.hpp"
#include "core/reason.hpp"

namespace ces
{

struct Episode
{
  static constexpr std::size_t MAX_REASONS = 4;  // listed by name

  Nanoseconds start = 0;  // by the node's clock
  double length_s = 0.0;
  std::array<Reason, MAX_REASONS> reasons{};
  std::size_t reason_count = 0;
  std::uint64_t withheld = 0;  // samples

  // All its reasons in one line.
  std::string describe_reasons() const;

  std::string describe() const;
};

struct EpisodeTotal
{
  std::uint64_t count = 0;
  double length_s = 0.0;
};

class Episodes
{
public:
  static constexpr std::size_t MAX_EPISODES = 10;  // ended episodes kept one by one; the totals count all

  // Add a reason for withholding; `withheld_before` counts the samples withheld before this one.
  void add_withheld(Reason reason, Nanoseconds now, std::uint64_t withheld_before);

  // End the episode, if there is one; `withheld` counts the samples withheld so far.
  // One that began at 0, before the first /clock of simulated time, is taken to begin now.
  void end_episode(Nanoseconds now, std::uint64_t withheld);

  std::uint64_t total() const {return total_;}
  std::size_t kept() const {return total_ < MAX_EPISODES ? static_cast<std::size_t>(total_) : MAX_EPISODES;}

  // One of the ended episodes kept; 0 is the newest.
  const Episode & newest(std::size_t back) const {return last_[(total_ - 1 - back) % MAX_EPISODES];}

  // The episodes by their first reason.
  const ByReason<EpisodeTotal> & by_reason() const {return by_reason_;}

private:
  std::uint64_t total_ = 0;
  std::array<Episode, MAX_EPISODES> last_;
  ByReason<EpisodeTotal> by_reason_;
  Episode present_;
};

}  // namespace ces

#endif  // HEALTH__EPISODES_HPP_
