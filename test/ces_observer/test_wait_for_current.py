"""Positions wait for their current, but not for ever, and leave in the order they came."""

from __future__ import annotations

from ces_observer.current_hold import MAX_POSITIONS, PositionQueue

MS = 1_000_000


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
