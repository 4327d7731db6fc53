// A queue that holds positions back until their current is known; they leave it in the order of arrival.
//
// Waiting for a current stamped no earlier than the position makes the force depend on the stamps alone, not on which of
// the two queues was read first. Memory is allocated when a wait is set, not with the samples.
#ifndef CORE__POSITION_QUEUE_HPP_
#define CORE__POSITION_QUEUE_HPP_

#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include "core/numbers.hpp"

namespace ces
{

struct Position
{
  Nanoseconds stamp = 0;
  double metres = 0.0;
  std::string frame;
  Nanoseconds arrival = 0;
};

class PositionQueue
{
public:
  // Set the longest wait by the node's clock; 0: none.
  void set_wait(double wait_s)
  {
    wait_ = to_ns(wait_s);
    if (wait_ > 0 && ring_.empty()) {
      ring_.resize(MAX_POSITIONS + 1);
      for (auto & position : ring_) {position.frame.reserve(FRAME_LENGTH);}
    }
  }

  // Whether positions have to wait, or some still do.
  bool is_waiting() const {return wait_ > 0 || count_ > 0;}

  // Add a position while `is_waiting`, and take what is ready before the next one is added.
  void add(Nanoseconds stamp, double metres, const std::string & frame, Nanoseconds now)
  {
    auto & place = ring_[(first_ + count_++) % ring_.size()];
    place.stamp = stamp;
    place.metres = metres;
    place.frame.assign(frame);
    place.arrival = now;
  }

  // Remove and return the next position whose wait is over; null if there is none. It is valid until the next `add`.
  // `known` is the stamp up to which the current is known. A clock that was set back ends the wait, too.
  const Position * pop_ready(std::optional<Nanoseconds> known, Nanoseconds now)
  {
    if (count_ == 0) {return nullptr;}
    const auto & first = ring_[first_];
    const bool is_known = known && *known >= first.stamp;
    if (!is_known && std::llabs(now - first.arrival) < wait_ && count_ <= MAX_POSITIONS) {return nullptr;}
    return pop();
  }

  // Remove and return the next position; null if there is none.
  const Position * pop()
  {
    if (count_ == 0) {return nullptr;}
    const auto & first = ring_[first_];
    first_ = (first_ + 1) % ring_.size();
    --count_;
    return &first;
  }

  void clear() {count_ = 0;}

private:
  static constexpr std::size_t MAX_POSITIONS = 10'000;  // several seconds at 1 kHz; beyond it the oldest is released
  static constexpr std::size_t FRAME_LENGTH = 64;

  Nanoseconds wait_ = 0;
  std::vector<Position> ring_;
  std::size_t first_ = 0, count_ = 0;
};

}  // namespace ces

#endif  // CORE__POSITION_QUEUE_HPP_
