// Processor load since the last measurement, as shares of one core: of the process and of the calling thread.
#ifndef HEALTH__LOAD_METER_HPP_
#define HEALTH__LOAD_METER_HPP_

#include <ctime>

#include "core/numbers.hpp"

namespace ces
{

struct Load {double process = 0.0, executor = 0.0;};

inline Nanoseconds read_clock(clockid_t clock)
{
  timespec time{};
  clock_gettime(clock, &time);
  return time.tv_sec * SECOND + time.tv_nsec;
}

class LoadMeter
{
public:
  // The shares since the last call; to be called by the thread that runs the executor.
  Load measure()
  {
    const auto now = read();
    const auto elapsed = static_cast<double>(now.wall - before_.wall);
    const Load load = elapsed > 0.0 ? Load{
      static_cast<double>(now.process - before_.process) / elapsed,
      static_cast<double>(now.thread - before_.thread) / elapsed} : Load{};
    before_ = now;
    return load;
  }

private:
  struct Times {Nanoseconds wall, process, thread;};

  static Times read()
  {
    return {read_clock(CLOCK_MONOTONIC), read_clock(CLOCK_PROCESS_CPUTIME_ID), read_clock(CLOCK_THREAD_CPUTIME_ID)};
  }

  Times before_ = read();
};

}  // namespace ces

#endif  // HEALTH__LOAD_METER_HPP_
