"""The current that holds at a position: by stamp, never from the future, never too old, as offline."""

from __future__ import annotations

from math import isnan, nan

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current
from ces_observer.current_hold import HISTORY, ConstantCurrent, CurrentHold
from ces_observer.limits import ClockLimits

MS = 1_000_000
MAX_AGE_S = 0.2


def hold_of(*samples: tuple[int, float]) -> CurrentHold:
    hold = CurrentHold(MAX_AGE_S)
    for stamp_ms, current in samples:
        hold.add(stamp_ms * MS, current)
    return hold


def test_newest_at_or_before_the_stamp() -> None:
    hold = hold_of((10, 0.3), (20, 0.5), (30, 0.7))
    assert [hold.at(stamp * MS) for stamp in (10, 19, 20, 29, 30, 200)] == [0.3, 0.3, 0.5, 0.5, 0.7, 0.7]


def test_nothing_before_the_first() -> None:
    assert isnan(hold_of().at(0))
    hold = hold_of((10, 0.3))
    assert isnan(hold.at(9 * MS))
    assert hold.explain(9 * MS).endswith("0.001 s before the first known current")
    assert hold.explain(-1000 * MS).endswith("are both on one clock?")


def test_age_limit_is_inclusive() -> None:
    hold = hold_of((0, 0.3))
    assert hold.at(200 * MS) == 0.3
    assert isnan(hold.at(200 * MS + 1))
    assert "0.2 s" in hold.explain(500 * MS)


def test_a_late_arrival_is_sorted_in() -> None:
    hold = hold_of((10, 0.1), (30, 0.3), (20, 0.2))
    assert [hold.at(stamp * MS) for stamp in (15, 25, 35)] == [0.1, 0.2, 0.3]


def test_not_finite_counts_as_not_received() -> None:
    hold = hold_of((0, 0.3), (100, nan), (150, float("inf")))
    assert hold.at(200 * MS) == 0.3
    assert isnan(hold.at(201 * MS))


def test_clock_set_back_forgets_the_future() -> None:
    hold = hold_of((0, 0.9))
    hold.add(10 * ClockLimits.JUMP_NS, 0.3)
    hold.add(5 * ClockLimits.JUMP_NS, 0.5)
    assert hold.at(5 * ClockLimits.JUMP_NS) == 0.5
    assert isnan(hold.at(10 * ClockLimits.JUMP_NS))


def test_memory_is_bounded_and_keeps_the_newest() -> None:
    hold = CurrentHold(1e6)
    for k in range(3 * HISTORY):
        hold.add(k * MS, float(k))
    assert hold.at((2 * HISTORY) * MS) == 2.0 * HISTORY
    assert isnan(hold.at((HISTORY - 1) * MS))


def test_another_view_has_the_same_currents_under_another_limit() -> None:
    hold = hold_of((0, 0.9))
    view = hold.with_max_age(10.0)
    hold.add(5 * MS, 0.5)
    assert isnan(hold.at(9000 * MS)) and view.at(9000 * MS) == 0.5
    assert view.newest_ns == hold.newest_ns == 5 * MS
    hold.reset()
    assert isnan(view.at(9000 * MS)) and view.newest_ns is None
    assert ConstantCurrent(0.4).with_max_age(1.0).at(10**19) == 0.4


def test_constant_holds_always() -> None:
    assert ConstantCurrent(0.4).at(-1) == ConstantCurrent(0.4).at(10**19) == 0.4


@given(
    st.lists(st.tuples(st.integers(0, 900), st.one_of(st.floats(-5, 5), st.just(nan))), min_size=1, max_size=100),
    st.lists(st.integers(-50, 1300), min_size=1, max_size=50),
)
def test_same_as_offline(currents: list[tuple[int, float]], positions: list[int]) -> None:
    currents = [(0, 0.1), *sorted(currents, key=lambda sample: sample[0])]
    stamps, values = zip(*currents, strict=True)
    channel = Channel("current", "A", np.array(stamps, dtype=np.int64) * MS, np.array(values))
    wanted = np.array(positions, dtype=np.int64) * MS
    offline = hold_current(Recording("r", {"current": channel}), wanted, MAX_AGE_S)
    live = [hold_of(*currents).at(int(stamp)) for stamp in wanted]
    np.testing.assert_array_equal(live, offline)
