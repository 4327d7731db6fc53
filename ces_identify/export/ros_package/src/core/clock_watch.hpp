// Detects that the computer's wall clock was set, by comparing it now and then with the steady clock.
#ifndef CORE__CLOCK_WATCH_HPP_
#define CORE__CLOCK_WATCH_HPP_

#include <cstdlib>

#include "core/numbers.hpp"

namespace ces
{

class ClockWatch
{
public:
  ClockWatch(Nanoseconds wall, Nanoseconds steady)
  : ahead_(wall - steady) {}

  // How far the wall clock was set since the last reading, positive if forward; 0 if it was not.
  Nanoseconds measure_jump(Nanoseconds wall, Nanoseconds steady)
  {
    const Nanoseconds ahead = wall - steady, jump = ahead - ahead_;
    ahead_ = ahead;
    return std::llabs(jump) >= MIN_JUMP ? jump : 0;
  }

private:
  static constexpr Nanoseconds MIN_JUMP = 100'000'000;  // far above what a slewed clock gains between two readings

  Nanoseconds ahead_;
};

}  // namespace ces

#endif  // CORE__CLOCK_WATCH_HPP_
