// What became of samples that are missing in the stamps: paused source, lost on the way, or lost in the node's queue.
//
// Where the middleware numbers the messages of a publisher, their numbers tell pauses from losses. Where it does not, only
// one cause is certain: the node's own queue was full, if the first message after the gap had waited for as long as a full
// queue takes.
#ifndef HEALTH__LOSSES_HPP_
#define HEALTH__LOSSES_HPP_

#include <cstdint>
#include <optional>

#include "core/numbers.hpp"

namespace ces
{

class Losses
{
public:
  // The topic's queue holds `depth` messages.
  explicit Losses(std::size_t depth)
  : depth_(static_cast<double>(depth)) {}

  // Messages that did not reach the node's callback, by their numbers; nothing if they have no numbers.
  std::optional<std::int64_t> lost() const {return lost_;}

  // Those of them that the node's own queue dropped.
  std::int64_t overflowed() const {return overflowed_;}

  // Take the number of the next message.
  void take_number(std::optional<std::uint64_t> number)
  {
    if (!number || switches_ > MAX_SWITCHES) {
      lost_.reset();
      return;
    }
    if (!last_) {
      lost_ = 0;
    } else if (*number > *last_) {
      lost_ = lost_.value_or(0) + static_cast<std::int64_t>(*number - *last_) - 1;
    } else {  // another publisher, or one that was started again
      ++switches_;
    }
    last_ = number;
  }

  // Count `missing` samples as overflowed if the message after them had waited for a full queue; return this.
  bool take_gap(std::int64_t missing, Nanoseconds waited, Nanoseconds period)
  {
    if (missing <= 0 || static_cast<double>(waited) < FULL_SHARE * depth_ * static_cast<double>(period)) {return false;}
    overflowed_ += missing;
    return true;
  }

private:
  static constexpr double FULL_SHARE = 0.9;  // of the queue's length in time: the period is an average
  static constexpr int MAX_SWITCHES = 20;  // more show that several publishers share the topic

  double depth_;
  std::optional<std::int64_t> lost_;
  std::int64_t overflowed_ = 0;
  std::optional<std::uint64_t> last_;
  int switches_ = 0;
};

}  // namespace ces

#endif  // HEALTH__LOSSES_HPP_
