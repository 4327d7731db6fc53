"""Unstamped messages are stamped with their arrival, and a wall clock that was set is noticed."""

from __future__ import annotations

from itertools import pairwise

import pytest

from ces_observer.arrival_clock import WINDOW_NS, ArrivalClock, ClockWatch
from ces_observer.limits import ClockLimits

MS = 1_000_000
SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def test_a_burst_after_a_stall_keeps_the_intervals_of_sending() -> None:
    clock = ArrivalClock()
    sent = [START + k * MS for k in range(1000)]
    read = [at + MS // 10 for at in sent[:300]] + [sent[900]] * 600 + [at + MS // 10 for at in sent[900:]]
    stamps = [clock.stamp(*pair) for pair in zip(sent, read, strict=True)]
    assert stamps[:300] == read[:300]
    assert {b - a for a, b in pairwise(stamps[299:])} <= {MS, MS - MS // 10}


def test_the_publishers_clock_may_differ() -> None:
    clock, ahead_ns = ArrivalClock(), 3600 * SECOND
    delays = [5 * MS, 2 * MS, 7 * MS, 90 * MS]
    stamps = [clock.stamp(START + k * SECOND + ahead_ns, START + k * SECOND + d) for k, d in enumerate(delays)]
    assert stamps == [START + k * SECOND + min(delays[: k + 1]) for k in range(len(delays))]


def test_an_unknown_time_of_sending_gives_the_time_of_reading() -> None:
    assert ArrivalClock().stamp(0, START) == START


def test_a_clock_that_was_set_is_learnt_anew() -> None:
    clock = ArrivalClock()
    clock.stamp(START, START + MS)
    back_ns = ClockLimits.MAX_DELAY_NS + SECOND
    assert clock.stamp(START - back_ns + SECOND, START + SECOND + MS) == START + SECOND + MS
    assert clock.stamp(START + 2 * SECOND, START + 2 * SECOND + 3 * MS) == START + 2 * SECOND + 3 * MS


def test_a_delay_that_has_grown_for_good_is_followed() -> None:
    clock = ArrivalClock()
    clock.stamp(START, START + MS)
    for k in range(1, 2 * WINDOW_NS // SECOND + 2):
        last = clock.stamp(START + k * SECOND, START + k * SECOND + 9 * MS) - START - k * SECOND
    assert last == 9 * MS


def test_reset_forgets_the_delays() -> None:
    clock = ArrivalClock()
    clock.stamp(START, START + MS)
    clock.reset()
    assert clock.stamp(START, START + 9 * MS) == START + 9 * MS


LOOK_NS = 100_000_000
WALL_NS, STEADY_NS = 1_700_000_000_000_000_000, 5_000_000_000


def jumps(steps_ns: list[int]) -> list[int]:
    """Return what is noticed at looks between which the wall clock gains these times."""
    watch, wall = ClockWatch(WALL_NS, STEADY_NS), WALL_NS
    found = []
    for k, step in enumerate(steps_ns, start=1):
        wall += LOOK_NS + step
        found.append(watch.measure_jump(wall, STEADY_NS + k * LOOK_NS))
    return found


@pytest.mark.parametrize(
    "jump_ns", [-3_600_000_000_000, -ClockLimits.MIN_STEP_NS, ClockLimits.MIN_STEP_NS, 2_500_000_000]
)
def test_a_jump_is_noticed_once(jump_ns: int) -> None:
    assert jumps([0, 0, jump_ns, 0, 0]) == [0, 0, jump_ns, 0, 0]


def test_steering_is_none() -> None:
    assert jumps([50_000] * 10_000) == [0] * 10_000  # 500 ppm, as much as a kernel steers
