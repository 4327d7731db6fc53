"""Whatever samples come, an estimator gives a force within its envelope or none: the estimator and its parts."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, isnan

import pytest
from constructed_models import constructed_damper
from damper_models import delayed_damper, plain_damper
from hypothesis import example, given, settings
from hypothesis import strategies as st
from trackers import Tracker
from trained_models import fuzzy_model, network_model

from ces_observer.current_hold import CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.estimator import Estimator
from ces_observer.model import Model, Sampling
from ces_observer.reasons import BEYOND_STROKE, NOT_FINITE, OK, OUT_OF_ORDER, OUTLIER, RESTARTED, UNSETTLED
from ces_observer.tick.tracker import check_tracker

MS = 1_000_000
LATEST_NS = 2**61  # beyond what a ROS stamp can hold
OUTCOMES = (OK, UNSETTLED, RESTARTED, OUT_OF_ORDER, OUTLIER, BEYOND_STROKE, NOT_FINITE)
QUICK = settings(max_examples=100, deadline=None, derandomize=True)


def soon(model: Model, **changes: object) -> Model:
    """Return the model with a short warm-up, so that a few samples are enough for forces."""
    return replace(model, sampling=replace(model.sampling, warm_up_s=0.003), **changes)


MODELS = {
    "polynomial": soon(plain_damper()),
    "tight": soon(plain_damper(), force_envelope_N=(-30.0, 20.0)),
    "constructed": soon(constructed_damper()),
    "network": soon(network_model()),
    "fuzzy": soon(fuzzy_model()),
    "speed": soon(plain_damper(motion="speed", motion_noise=0.01)),
    "acceleration": soon(plain_damper(motion="acceleration", motion_noise=1.0)),
    "late": delayed_damper(0.005, warm_up_s=0.003),
}

odd = st.one_of(
    st.floats(),  # NaN, infinities and denormals among them
    st.sampled_from([0.0, -0.0, 5e-324, 1e308, -1.7e308, True, False, 10**9]),
    st.floats(-0.3, 0.3),
)
good = st.floats(-0.05, 0.05)
steps_ns = st.one_of(
    st.integers(MS * 9 // 10, MS * 11 // 10),
    st.sampled_from([0, 1, -MS, 50 * MS, 51 * MS, -10 * MS, 10**9, -(10**9)]),
    st.integers(-LATEST_NS, LATEST_NS),
)
mostly = st.tuples(st.integers(MS * 9 // 10, MS * 11 // 10), good, st.floats(0.0, 1.5))
samples = st.lists(st.one_of(mostly, mostly, mostly, st.tuples(steps_ns, odd, odd)), min_size=1, max_size=60)


def stamped(steps: list[tuple[int, float, float]]) -> list[tuple[int, float, float]]:
    """Return the samples with stamps [ns] instead of steps."""
    stamp, found = 10**18, []
    for step_ns, position, current in steps:
        stamp = min(max(stamp + step_ns, -LATEST_NS), LATEST_NS)
        found.append((stamp, position, current))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_a_force_is_within_the_envelope_or_withheld(name: str) -> None:
    model = MODELS[name]
    low, high = model.force_envelope_N
    given_forces = []

    @QUICK
    @given(samples)
    @example([(MS, 1e-6 * k, 0.5) for k in range(20)])  # so slow that even a tight envelope holds the force
    def holds(steps: list[tuple[int, float, float]]) -> None:
        estimator = Estimator(model)
        for stamp, position, current in stamped(steps):
            force = estimator.step(stamp, position, current, current)  # as wild a speed or acceleration
            assert (force is None) == (estimator.reason != OK) or name == "late"
            for one in estimator.late:
                assert one.stamp_ns < stamp and isfinite(one.position) and isfinite(one.speed)
            forces = [f for f in (force, *(one.force for one in estimator.late)) if f is not None]
            assert all(low <= f <= high for f in forces)
            assert isfinite(estimator.position) and isfinite(estimator.speed)
            given_forces.append(bool(forces))

    holds()
    assert any(given_forces) and not all(given_forces)


def test_a_force_between_ticks_stays_within_the_envelope() -> None:
    """The line through the last two ticks' forces would leave it."""
    model = MODELS["tight"]
    estimator, period_ns = Estimator(model), MS * 4 // 3
    forces = [estimator.step(k * period_ns, 2.5e-6 * k * k, 0.5) for k in range(60)]
    kept = [force for force in forces if force is not None]
    assert 20.0 in kept
    assert max(kept) == 20.0


@pytest.mark.slow
def test_it_recovers_from_whatever_came() -> None:
    @QUICK
    @given(samples, st.sampled_from(sorted(MODELS)))
    def recovers(steps: list[tuple[int, float, float]], name: str) -> None:
        estimator = Estimator(MODELS[name])
        for stamp, position, current in stamped(steps):
            estimator.step(stamp, position, current, current)
        later = stamped(steps)[-1][0] + 3600 * 10**9
        forces = [estimator.step(later + k * MS, 1e-7 * k, 0.5) or estimator.late for k in range(200)]
        assert all(forces[100:])

    recovers()


@pytest.mark.slow
@QUICK
@given(samples, st.booleans(), st.floats(0.0, 1.0))
def test_a_damper_always_says_what_it_does(
    steps: list[tuple[int, float, float]], follows: bool, max_age_s: float
) -> None:
    model = MODELS["polynomial"]
    damper = DamperObserver(model, CurrentHold(model.sampling.max_current_age_s), max_age_s)
    for stamp, position, current in stamped(steps):
        damper.take_current(stamp, current)
        force = damper.step(stamp, position, stamp if follows else 10**18)
        assert (force is None) == (damper.reason != OK)
        assert force is None or abs(force) <= 8000.0
        assert "\n" not in damper.explain()
    assert damper.tally.samples == len(steps)
    assert damper.tally.estimates + sum(damper.tally.withheld.values()) == len(steps)


@QUICK
@given(st.lists(st.tuples(steps_ns, odd), max_size=80), st.integers(-LATEST_NS, LATEST_NS))
def test_a_current_that_holds_was_received_and_is_not_too_old(currents: list[tuple[int, float]], at_ns: int) -> None:
    hold = CurrentHold(0.2)
    stamp, put = at_ns, []
    for step_ns, current in currents:
        stamp += step_ns
        hold.add(stamp, current)
        put.append((stamp, current))
    for when in (at_ns, stamp, stamp + 100 * MS):
        current = hold.at(when)
        assert "\n" not in hold.explain(when)
        assert isnan(current) or any(value == current and 0 <= when - t <= 200 * MS for t, value in put)


@st.composite
def samplings(draw: st.DrawFn) -> Sampling:
    """Draw any sampling that a model file may hold."""
    rate = draw(st.floats(1.0, 1e5))
    shares = st.lists(st.floats(1e-4, 0.4999), min_size=1, max_size=3)
    motion = draw(st.sampled_from(["", "speed", "acceleration"]))
    return Sampling(
        rate_Hz=rate,
        noise_m=draw(st.floats(1e-12, 1.0)),
        speed_m_s=draw(st.floats(1e-9, 1e3)),
        stroke_m=draw(st.sampled_from([(-1e6, 1e6), (-0.1, 0.1)])),
        outlier_m=draw(st.floats(1e-9, 1e3)),
        frequencies_Hz=tuple(share * rate for share in draw(shares)),
        max_gap_s=draw(st.floats(1e-4, 0.02)),
        delay_s=draw(st.integers(0, min(int(0.02 * rate), 20))) / rate,
        motion=motion,
        motion_noise=draw(st.floats(1e-9, 1e6)) if motion else 0.0,
    )


@pytest.mark.slow
@settings(QUICK, max_examples=60)
@given(samplings(), st.lists(st.tuples(steps_ns, odd), max_size=60))
@example(
    Sampling(1e5, 1e-12, 1e-9, (-1e6, 1e6), 1e3, (4e4,), 0.02),
    [(1, 0.0), (1, 1e3), (1, -1e3), (19 * MS, 1e3), (1, 1e9), (1, -1e9)] * 3,
)
def test_a_tracker_makes_finite_ticks(sampling: Sampling, steps: list[tuple[int, float]]) -> None:
    tracker, stamp = Tracker(sampling), 0
    assert check_tracker(*tracker.arrays[:2], *map(len, tracker.arrays))
    for step_ns, position in steps:
        stamp = min(max(stamp + step_ns, -LATEST_NS), LATEST_NS)
        assert tracker.advance(stamp, position, position) in OUTCOMES
        assert all(isfinite(x) and isfinite(v) for x, v in tracker.ticks + [t for t in tracker.late_ticks if t])
        assert len(tracker.late_ticks) in (0, len(tracker.ticks))
        assert len(tracker.ticks) <= sampling.rate_Hz * sampling.max_gap_s + 2
        assert -0.5 <= tracker.ahead <= 0.5
