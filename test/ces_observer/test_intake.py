"""Positions wait for their current, but not for ever, and leave in the order they came."""

from __future__ import annotations

from damper_models import plain_damper

from ces_observer.current_hold import CurrentHold
from ces_observer.damper_observer import NO_CURRENT, DamperObserver
from ces_observer.intake import MAX_POSITIONS, Intake
from ces_observer.limits import ClockLimits

MS = 1_000_000
JUMP_MS = 2 * ClockLimits.JUMP_NS // MS


class Held:
    """An intake that has got positions of these stamps, each of which arrived at its stamp."""

    def __init__(self, *stamps_ms: int, wait_s: float = 0.02) -> None:
        self.left: list[tuple[int, bytes, str]] = []
        self.damper = DamperObserver(plain_damper(), CurrentHold(0.2), 0.0)
        self.intake = Intake(self.damper, lambda stamp, frame, _: self.left.append((stamp, frame, self.damper.reason)))
        self.intake.set_wait(wait_s)
        for stamp in stamps_ms:
            self.take(stamp, stamp)

    def take(self, stamp_ms: int, now_ms: int) -> None:
        self.intake.take_position(stamp_ms * MS, 0.0, b"frame", now_ms * MS)

    def let_go(self, current_ms: int | None, now_ms: int) -> list[int]:
        """Give a current, if there is one; return the stamps of the positions that have left since the last call."""
        if current_ms is not None:
            self.intake.take_current(current_ms * MS, 0.5, now_ms * MS)
        self.intake.release(now_ms * MS)
        stamps = [stamp // MS for stamp, _, _ in self.left]
        self.left.clear()
        return stamps


def test_a_current_stamped_no_earlier_ends_the_wait() -> None:
    held = Held(1, 2, 3)
    assert held.let_go(None, 3) == []
    assert held.let_go(2, 3) == [1, 2]
    held.intake.take_current(3 * MS, 0.5, 3 * MS)
    assert held.left == [(3 * MS, b"frame", "warming up")]


def test_the_wait_ends_after_its_time() -> None:
    held = Held(1, 2)
    assert held.let_go(0, 20) == []
    assert held.let_go(0, 21) == [1]
    assert held.let_go(0, 22) == [2]


def test_a_position_before_the_beginning_of_simulated_time_waits_from_then_on() -> None:
    held = Held()
    held.take(5000, 0)
    assert held.let_go(None, 5001) == []
    assert held.let_go(None, 5020) == []
    assert held.let_go(None, 5021) == [5000]


def test_a_clock_set_back_ends_the_wait() -> None:
    assert Held(100, 101).let_go(0, 50) == [100, 101]


def test_positions_leave_in_the_order_of_arrival() -> None:
    held = Held(5, 3, 4)
    assert held.let_go(4, 5) == []
    assert held.let_go(5, 5) == [5, 3, 4]


def test_no_more_than_a_bounded_number_is_held() -> None:
    held = Held(*range(MAX_POSITIONS + 3), wait_s=1e6)
    assert held.let_go(None, MAX_POSITIONS) == [0, 1, 2]


def test_switched_off_it_still_lets_go_what_it_holds() -> None:
    held = Held(1)
    held.intake.set_wait(0.0)
    held.take(2, 1)
    assert held.let_go(None, 1) == [1, 2]
    held.take(3, 1)
    assert held.let_go(None, 1) == [3]


def test_a_reset_empties_it() -> None:
    held = Held(1, 2)
    held.intake.reset(2 * MS)
    assert held.let_go(None, 2) == [1, 2]


def test_currents_that_jump_back_let_go_the_positions_of_the_time_before_with_its_currents() -> None:
    held = Held()
    assert held.let_go(JUMP_MS, 1) == []
    held.take(JUMP_MS + 5, 1)
    held.intake.take_current(0, 0.5, 1 * MS)
    assert held.left == [((JUMP_MS + 5) * MS, b"frame", "warming up")]


def test_positions_that_jump_back_take_no_current_of_the_time_before() -> None:
    """Also where one has a stamp that would fit; a current that has jumped before them is theirs."""
    for wait_s, reason in ((0.0, NO_CURRENT), (0.02, "warming up")):
        held = Held(wait_s=wait_s)
        for stamp_ms in range(0, JUMP_MS, 10):
            held.intake.take_current(stamp_ms * MS, 0.5, stamp_ms * MS)
        held.take(JUMP_MS, JUMP_MS)
        held.take(5, JUMP_MS)
        held.let_go(4, JUMP_MS)
        held.let_go(6, JUMP_MS)
        assert held.damper.reason == reason
        held.take(6, JUMP_MS)
        assert held.damper.reason == "warming up"
    held.take(JUMP_MS, JUMP_MS)
    held.intake.take_current(7 * MS, 0.5, JUMP_MS * MS)
    held.take(7, JUMP_MS)
    assert held.damper.reason == "warming up"
