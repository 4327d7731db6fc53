"""One damper without ROS: the estimator's own forces, and a named reason whenever there is none."""

from __future__ import annotations

from math import inf, nan, pi, sin

import pytest
from damper_models import plain_damper

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.estimator import UNBOUNDED, WARMING_UP, Estimator
from ces_observer.model import Model
from ces_observer.tracker import OK, OUT_OF_ORDER, OUTLIER

MS = 1_000_000
START = 1_700_000_000_000 * MS


def stroke(k: int) -> float:
    """Return 20 mm at 2 Hz at millisecond `k`."""
    return 0.02 * sin(2.0 * pi * 2.0 * k * 1e-3)


def observer(model: Model | None = None, max_age_s: float = 0.5) -> DamperObserver:
    return DamperObserver(model or plain_damper(), CurrentHold(0.2), max_age_s)


def run(damper: DamperObserver, first: int, last: int, current: float | None = 0.5) -> list[float | None]:
    """Step through milliseconds [first, last) with a current every 5 ms."""
    forces = []
    for k in range(first, last):
        stamp = START + k * MS
        if current is not None and k % 5 == 0:
            damper.take_current(stamp, current)
        forces.append(damper.step(stamp, stroke(k), stamp + MS))
    return forces


def test_forces_are_the_estimators() -> None:
    estimator = Estimator(plain_damper())
    expected = [estimator.step(START + k * MS, stroke(k), 0.5) for k in range(1000)]
    damper = observer()
    assert run(damper, 0, 1000) == expected
    assert damper.reason == OK
    assert damper.tally.estimates == sum(force is not None for force in expected) > 800
    assert damper.tally.withheld == {WARMING_UP: 1000 - damper.tally.estimates}


def test_withholds_without_current_and_says_why() -> None:
    damper = observer()
    assert run(damper, 0, 300, current=None) == [None] * 300
    assert damper.reason == NO_CURRENT
    assert damper.explain() == ""  # the node adds what it knows of the topic
    run(damper, 300, 600)
    assert damper.reason == OK
    run(damper, 600, 900, current=None)
    assert damper.reason == NO_CURRENT
    assert "0.2 s" in damper.explain()


def test_constant_current_needs_no_samples() -> None:
    damper = DamperObserver(plain_damper(), ConstantCurrent(0.5), 0.5)
    damper.take_current(START, 99.0)
    assert run(damper, 0, 1000) == run(observer(), 0, 1000)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_bad_position_is_left_out(bad: float) -> None:
    damper = observer()
    run(damper, 0, 300)
    assert damper.step(START + 300 * MS, bad, START + 300 * MS) is None
    assert damper.reason == POSITION_NOT_FINITE
    assert None not in run(damper, 301, 400)


def test_outlier_and_repeat_are_left_out() -> None:
    damper = observer()
    run(damper, 0, 300)
    assert damper.step(START + 300 * MS, 0.09, START + 300 * MS) is None
    assert damper.reason == OUTLIER
    run(damper, 300, 400)
    assert damper.step(START + 399 * MS, stroke(399), START + 400 * MS) is None
    assert damper.reason == OUT_OF_ORDER
    assert None not in run(damper, 400, 500)


def test_no_current_given_as_nan() -> None:
    damper = observer()
    run(damper, 0, 300, current=nan)
    assert (damper.reason, damper.explain()) == (NO_CURRENT, "the current is nan")


@pytest.mark.parametrize(("late_s", "side"), [(2.0, "behind"), (-2.0, "ahead")])
def test_stamps_off_the_clock_are_withheld_but_estimated(late_s: float, side: str) -> None:
    damper = observer()
    expected = run(observer(), 0, 400)
    run(damper, 0, 300)
    stamp = START + 300 * MS
    damper.take_current(stamp, 0.5)
    assert damper.step(stamp, stroke(300), stamp + round(late_s * 1e9)) is None
    assert damper.reason == OFF_CLOCK
    assert f"2 s {side}" in damper.explain()
    assert run(damper, 301, 400) == expected[301:]


def test_age_check_can_be_switched_off() -> None:
    damper = observer(max_age_s=0.0)
    run(damper, 0, 300)
    assert damper.step(START + 300 * MS, stroke(300), 0) is not None
    damper.allow_age(0.5)
    assert damper.step(START + 301 * MS, stroke(301), 0) is None


@pytest.mark.parametrize(("max_age_s", "reason"), [(0.0, OUT_OF_ORDER), (0.5, OFF_CLOCK)])
def test_unset_header_stamp_is_named(max_age_s: float, reason: str) -> None:
    damper = DamperObserver(plain_damper(), ConstantCurrent(0.5), max_age_s)
    for k in range(3):
        damper.step(0, stroke(k), START)
    assert damper.reason == reason
    assert "header stamp is 0" in damper.explain()


def test_messages_of_other_joints_matter_only_when_ours_are_missing() -> None:
    damper = observer()
    for k in range(300):
        damper.unreadable_position("no joint 'rear'")
        run(damper, k, k + 1)
    assert damper.reason == OK
    damper.unreadable_position("no joint 'rear'")
    damper.silence()
    assert (damper.reason, damper.explain()) == (SILENT, "no joint 'rear'")
    assert damper.tally.unreadable == 301


def test_a_force_beyond_its_envelope_is_never_given() -> None:
    runaway = plain_damper()
    object.__setattr__(runaway, "force_envelope_N", (-10.0, 10.0))
    damper = observer(runaway)
    assert all(force is None or abs(force) <= 20.0 for force in run(damper, 0, 1000))
    assert damper.tally.withheld[UNBOUNDED] > 0
