"""The current that holds at a position: by stamp, never from the future, never too old, as offline."""

from __future__ import annotations

from math import isnan, nan

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current
from ces_observer.current_hold import HISTORY, MAX_POSITIONS, ConstantCurrent, CurrentHold, PositionQueue
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


# ------------------------------ Positions wait for their current, but not for ever, and leave in the order they came.


def held(*stamps_ms: int, wait_s: float = 0.02) -> PositionQueue:
    """Return a queue with positions of these stamps, each of which arrived at its stamp."""
    queue = PositionQueue(wait_s)
    for stamp in stamps_ms:
        queue.add(stamp * MS, stamp * 1e-3, b"frame", stamp * MS)
    return queue


def let_go(queue: PositionQueue, current_ms: int | None, now_ms: int) -> list[int]:
    current_ns = None if current_ms is None else current_ms * MS
    return [stamp // MS for stamp, _, _ in queue.pop_ready(current_ns, now_ms * MS)]


def test_a_current_stamped_no_earlier_ends_the_wait() -> None:
    queue = held(1, 2, 3)
    assert let_go(queue, None, 3) == []
    assert let_go(queue, 2, 3) == [1, 2]
    assert let_go(queue, 2, 3) == []
    assert list(queue.pop_ready(3 * MS, 3 * MS)) == [(3 * MS, 3e-3, b"frame")]


def test_the_wait_ends_after_its_time() -> None:
    queue = held(1, 2)
    assert let_go(queue, 0, 20) == []
    assert let_go(queue, 0, 21) == [1]
    assert let_go(queue, 0, 22) == [2]


def test_a_position_before_the_beginning_of_simulated_time_waits_from_then_on() -> None:
    queue = PositionQueue(0.02)
    queue.add(5000 * MS, 0.0, b"", 0)
    assert let_go(queue, None, 5001) == []
    assert let_go(queue, None, 5020) == []
    assert let_go(queue, None, 5021) == [5000]


def test_a_clock_set_back_ends_the_wait() -> None:
    assert let_go(held(100, 101), 0, 50) == [100, 101]


def test_positions_leave_in_the_order_of_arrival() -> None:
    queue = held(5, 3, 4)
    assert let_go(queue, 4, 5) == []
    assert let_go(queue, 5, 5) == [5, 3, 4]


def test_no_more_than_a_bounded_number_is_held() -> None:
    queue = held(*range(MAX_POSITIONS + 3), wait_s=1e6)
    assert let_go(queue, None, MAX_POSITIONS) == [0, 1, 2]


def test_switched_off_it_still_lets_go_what_it_holds() -> None:
    queue = held(1)
    assert queue.is_waiting
    queue.set_wait(0.0)
    assert queue.is_waiting
    assert let_go(queue, None, 1) == [1]
    assert not queue.is_waiting


def test_all_empties_the_queue() -> None:
    queue = held(1, 2)
    assert [stamp for stamp, _, _ in queue.pop_all()] == [MS, 2 * MS]
    assert let_go(queue, 10, 10) == []
