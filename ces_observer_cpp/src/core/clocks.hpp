// Readings of clocks, and the stamps of messages that have none.
#pragma once

#include <ctime>

#include "core/samples.hpp"

namespace ces {

inline Nanoseconds read_clock(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return time.tv_sec * SECOND + time.tv_nsec;
}

// Stamps messages that have no stamp: time of sending and of arrival in, the arrival without the node's own delay
// out.
//
// A message that waited in the node's queue, as in a stall, was sent earlier than it is read. The time of sending
// comes from the publisher's clock, which may differ from the node's, so the least delay of the recent messages is
// taken as the difference of the clocks with the delay of transport. A message's stamp is its time of sending plus
// this least delay.
class ArrivalClock {
public:
  // The stamp of a message sent at `sent` and read at `now`; 0 or less: sending unknown.
  Nanoseconds stamp(Nanoseconds sent, Nanoseconds now) {
    if (sent <= 0) {return now;}
    const auto delay = now - sent;
    if (is_empty_ || delay - least_ > MAX_DELAY) {
      is_empty_ = false;
      least_ = next_ = delay;
      began_ = now;
    } else if (delay < next_) {
      next_ = delay;
      least_ = std::min(least_, delay);
    }
    if (now < began_ || now - began_ >= WINDOW) {
      least_ = next_;
      next_ = delay;
      began_ = now;
    }
    return sent + least_;
  }

private:
  static constexpr Nanoseconds WINDOW = 20 * SECOND;  // the least delay is that of one to two windows
  static constexpr Nanoseconds MAX_DELAY = 10 * SECOND;  // beyond the least: the publisher's clock was set back

  bool is_empty_ = true;
  Nanoseconds least_ = 0, next_ = 0, began_ = 0;
};

}  // namespace ces
