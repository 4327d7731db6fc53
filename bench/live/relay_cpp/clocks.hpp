// Readings of clocks [ns], sleeping, and real-time scheduling.
#pragma once

#include <sched.h>

#include <ctime>
#include <stdexcept>

using Nanoseconds = int64_t;

constexpr Nanoseconds SECOND = 1'000'000'000;

inline Nanoseconds read_clock(clockid_t clock)
{
  timespec time{};
  if (clock_gettime(clock, &time) != 0) {throw std::runtime_error("the process under test has ended");}
  return time.tv_sec * SECOND + time.tv_nsec;
}

inline void sleep_until(Nanoseconds at)
{
  const timespec time{at / SECOND, at % SECOND};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) != 0) {}
}

inline void sleep_for(double seconds) {sleep_until(read_clock(CLOCK_MONOTONIC) + static_cast<Nanoseconds>(seconds * SECOND));}

// Run this thread and those that it starts under SCHED_FIFO; returns the priority in force, 0 if that is not permitted.
inline int use_priority(int priority)
{
  sched_param parameters{};
  parameters.sched_priority = priority;
  return priority > 0 && sched_setscheduler(0, SCHED_FIFO, &parameters) == 0 ? priority : 0;
}
