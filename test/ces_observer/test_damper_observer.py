"""One damper without ROS: the estimator's own forces, and a named reason whenever there is none."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan, pi, sin

import pytest
from damper_models import delayed_damper, plain_damper

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import NO_CURRENT, OFF_CLOCK, POSITION_NOT_FINITE, SILENT, DamperObserver
from ces_observer.estimator import Estimator, LateEstimate
from ces_observer.model import Model
from ces_observer.reasons import BEYOND_STROKE, OK, OUT_OF_ORDER, OUTLIER, RESTARTED, WARMING_UP
from ces_observer.structures.polynomial import Polynomial

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


def run_late(damper: DamperObserver, first: int, last: int) -> list[LateEstimate]:
    """Step through milliseconds [first, last); return the estimates that came late."""
    return [one for k in range(first, last) for _ in run(damper, k, k + 1) for one in damper.late]


def stamps(late: list[LateEstimate]) -> list[int]:
    """Return the milliseconds of estimates."""
    return [(one.stamp_ns - START) // MS for one in late]


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


def test_without_a_current_the_hold_returns_nan() -> None:
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
    damper.set_max_age(5e-324)  # is not 0
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
        damper.count_unreadable("position", "no joint 'rear'")
        run(damper, k, k + 1)
    assert damper.reason == OK
    damper.count_unreadable("position", "no joint 'rear'")
    damper.report_silence()
    assert (damper.reason, damper.explain()) == (SILENT, "no joint 'rear'")
    assert damper.tally.unreadable == 301


def test_a_force_beyond_its_envelope_is_held_and_counted_without_a_new_warm_up() -> None:
    damper = observer(replace(plain_damper(), force_envelope_N=(-10.0, 10.0)))
    forces = [force for force in run(damper, 0, 1000) if force is not None]
    assert {min(forces), max(forces)} == {-10.0, 10.0}
    assert set(damper.tally.withheld) == {WARMING_UP}
    assert 0.5 * len(forces) < damper.tally.held < len(forces) == damper.tally.estimates


def harder(factor: float = 2.0, **sampling: float) -> Model:
    """Return the plain damper with forces `factor` times as large."""
    model = plain_damper(**sampling)
    past, *others = model.body.terms
    return replace(
        model, body=Polynomial((past, *(replace(term, coefficient=factor * term.coefficient) for term in others)))
    )


def test_a_loaded_model_takes_over_when_warm_and_no_force_is_missing() -> None:
    new = Estimator(harder())
    damper = observer()
    run(damper, 0, 500)
    damper.load(harder())
    assert damper.next_model == harder() and damper.model == plain_damper()
    forces = run(damper, 500, 1000)
    assert None not in forces
    alone = [new.step(START + k * MS, stroke(k), 0.5) for k in range(500, 1000)]
    takes_over = next(k for k, force in enumerate(alone) if force is not None)
    assert forces[takes_over:] == alone[takes_over:]
    old = observer()
    assert forces[:takes_over] == run(old, 0, 1000)[500 : 500 + takes_over]
    assert damper.model == harder() and damper.next_model is None


def test_a_loaded_model_without_samples_waits() -> None:
    damper = observer()
    damper.load(harder())
    damper.report_silence()
    assert damper.model == plain_damper() and damper.next_model == harder()


def test_the_newest_of_two_loaded_models_takes_over() -> None:
    damper = observer()
    run(damper, 0, 300)
    damper.load(harder(2.0))
    run(damper, 300, 350)
    damper.load(harder(3.0))
    assert None not in run(damper, 350, 700)
    assert damper.model == harder(3.0)


def test_a_loaded_model_brings_its_own_limit_for_the_current() -> None:
    damper = observer()
    run(damper, 0, 300)
    damper.load(plain_damper(max_current_age_s=0.5))
    run(damper, 300, 600)
    forces = run(damper, 600, 1000, current=None)
    assert None not in forces[:300]
    assert "0.5 s" not in damper.explain()
    assert run(damper, 1000, 1200, current=None)[-1] is None
    assert "the model allows 0.5 s" in damper.explain()


def test_a_loaded_model_takes_over_from_one_that_gives_no_force() -> None:
    damper = observer(plain_damper(warm_up_s=60.0))
    run(damper, 0, 500)
    assert damper.reason == WARMING_UP
    damper.load(plain_damper())
    assert run(damper, 500, 900)[-1] is not None


def test_reset_begins_anew_and_keeps_the_counts() -> None:
    damper = observer()
    run(damper, 0, 500)
    damper.reset()
    assert damper.reason == WARMING_UP
    assert damper.tally.samples == 500
    damper.step(START - 10**15, 0.0, START - 10**15)
    assert damper.reason == NO_CURRENT
    assert run(damper, -(10**6), -(10**6) + 500)[-1] is not None


def test_a_delayed_estimate_comes_once_for_each_sample_with_its_stamp() -> None:
    damper = observer(delayed_damper(0.003))
    late = run_late(damper, 0, 1000)
    assert stamps(late) == list(range(100, 997))  # after 0.1 s of warm-up, 3 ms ago
    assert damper.tally.late == damper.tally.estimates == len(late)
    assert all(abs(one.position - stroke((one.stamp_ns - START) // MS)) < 1e-4 for one in late)
    assert run(damper, 1000, 1001) == [None]
    assert damper.reason == OK


def test_delayed_estimates_that_are_old_or_would_follow_a_bad_sample_are_withheld() -> None:
    damper = observer(delayed_damper(0.003), max_age_s=0.01)
    run_late(damper, 0, 300)
    for age in (20 * MS, -20 * MS):
        damper.take_current(START + 300 * MS, 0.5)
        assert damper.step(START + 300 * MS, stroke(300), START + 300 * MS + age) is None
        assert damper.reason in (OFF_CLOCK, OUT_OF_ORDER) and not damper.late
    damper.step(START + 301 * MS, nan, START + 301 * MS)
    assert not damper.late
    assert stamps(run_late(damper, 302, 310)) == [298, 299, 300, 302, 303, 304, 305, 306]


def test_before_a_gap_the_last_samples_have_no_delayed_estimate() -> None:
    damper = observer(delayed_damper(0.003))
    run_late(damper, 0, 300)
    late = run_late(damper, 400, 700)  # 0.1 s without samples: the estimator restarts
    assert stamps(late) == list(range(500, 697))


def test_a_bridged_gap_withholds_delayed_estimates_that_became_too_old() -> None:
    damper = observer(delayed_damper(0.003, max_gap_s=0.3), max_age_s=0.05)
    run_late(damper, 0, 300)
    damper.take_current(START + 400 * MS, 0.5)
    damper.step(START + 400 * MS, stroke(400), START + 400 * MS)
    assert not damper.late  # of samples 0.1 s ago


@pytest.mark.parametrize("delays_s", [(0.003, 0.02), (0.02, 0.003)])
def test_a_delayed_model_follows_another_and_each_stamp_comes_once(delays_s: tuple[float, float]) -> None:
    damper = observer(delayed_damper(delays_s[0]))
    late = run_late(damper, 0, 500)
    damper.load(delayed_damper(delays_s[1]))
    late += run_late(damper, 500, 1000)
    found = stamps(late)
    assert found == sorted(set(found)) and found[-1] == 999 - round(1e3 * delays_s[1])
    assert len(found) >= found[-1] - found[0] + 1 - 17  # of the shorter delay's first samples, some are left out


def test_a_delayed_model_takes_over_from_one_without_and_the_other_way_round() -> None:
    damper = observer()
    assert not run_late(damper, 0, 300)
    damper.load(delayed_damper(0.003))
    forces = run(damper, 300, 600)
    taken = forces.index(None)
    assert forces[taken:] == [None] * (300 - taken) and damper.reason == OK and damper.late
    damper.load(plain_damper())
    assert run(damper, 600, 900)[-1] is not None and not damper.late


def test_a_position_beyond_the_stroke_is_named() -> None:
    damper = observer()
    run(damper, 0, 300)
    damper.take_current(START + 300 * MS, 0.5)
    assert damper.step(START + 300 * MS, 1500.0, START + 300 * MS) is None
    assert (damper.reason, damper.explain()) == (
        BEYOND_STROKE,
        "1500 m, the model takes -1 to 1 m; check scale and offset",
    )
    assert None not in run(damper, 301, 400)


def test_a_restart_after_a_gap_is_told() -> None:
    damper = observer()
    run(damper, 0, 300)
    run(damper, 400, 410)
    assert (damper.reason, damper.explain()) == (WARMING_UP, RESTARTED)
