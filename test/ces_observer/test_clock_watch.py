"""A wall clock that is set is noticed, one that is steered is not."""

from __future__ import annotations

import pytest

from ces_observer.clock_watch import MIN_JUMP_NS, ClockWatch

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


@pytest.mark.parametrize("jump_ns", [-3_600_000_000_000, -MIN_JUMP_NS, MIN_JUMP_NS, 2_500_000_000])
def test_a_jump_is_noticed_once(jump_ns: int) -> None:
    assert jumps([0, 0, jump_ns, 0, 0]) == [0, 0, jump_ns, 0, 0]


def test_steering_is_none() -> None:
    assert jumps([50_000] * 10_000) == [0] * 10_000  # 500 ppm, as much as a kernel steers
