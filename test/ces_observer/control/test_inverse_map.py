"""The inverse map: current back from force wherever the force depends on it, monotone and bounded everywhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from damper_models import plain_damper
from hydraulic_models import hydraulic_model, make_hydraulic
from hypothesis import given
from hypothesis import strategies as st
from physical_models import LINEAR, NO_SIDE, PLAIN_VALVE, fitted_model

from ces_observer.control.inverse_map import InverseMap, compute_inverse_map, current_lag_s, run_to_steady, steady_force
from ces_observer.errors import CesError, ModelError
from ces_observer.model import Envelope, Model, load_model
from ces_observer.structures.hydraulic import FrictionElement, yield_at_mid_stroke
from ces_observer.structures.polynomial import Factor, Polynomial, Term

MODELS = Path(__file__).resolve().parents[3] / "config" / "models"
SPEEDS = st.floats(-3.0, 3.0)
CURRENTS = st.floats(0.0, 2.0)


@cache
def inverse_of(name: str) -> InverseMap:
    """Return the map of the plain damper or of a packaged model."""
    return compute_inverse_map(load_model(MODELS / f"{name}.json") if name != "plain" else plain_damper())


def test_it_is_the_models_steady_force() -> None:
    """The plain damper settles at F = (2000 + 1000 i) v."""
    plain = inverse_of("plain")
    for speed in (-2.0, -0.3, -0.01, 0.004, 0.05, 1.7):
        for current in (0.0, 0.6, 2.0):
            assert plain.force(speed, current) == pytest.approx((2000.0 + 1000.0 * current) * speed, rel=2e-3)


@given(SPEEDS.filter(lambda v: abs(v) > 1e-3), CURRENTS)
def test_current_undoes_force(speed: float, current: float) -> None:
    assert inverse_of("plain").current(speed, inverse_of("plain").force(speed, current)) == pytest.approx(
        current, abs=1e-6
    )


@given(SPEEDS, st.floats(-1e9, 1e9))
def test_the_current_stays_inside_the_envelope(speed: float, force: float) -> None:
    low, high = inverse_of("sample").currents_A[0], inverse_of("sample").currents_A[-1]
    assert low <= inverse_of("sample").current(speed, force) <= high


@given(SPEEDS, st.floats(-4000.0, 4000.0), st.floats(0.0, 500.0))
def test_a_request_for_more_damping_never_reduces_the_current(speed: float, force: float, more: float) -> None:
    firmer = force + more if speed >= 0.0 else force - more
    assert inverse_of("sample").current(speed, firmer) >= inverse_of("sample").current(speed, force)


@given(SPEEDS, st.floats(0.25, 0.75))
def test_the_slope_has_the_sign_of_the_speed(speed: float, current: float) -> None:
    assert inverse_of("sample").slope(speed, current) * speed >= 0.0


def test_what_is_not_monotone_in_the_model_is_in_the_map() -> None:
    """F = v (1000 i - 500 i^2) falls again beyond 1 A: no more current is asked for where it brings nothing."""
    inverse = compute_inverse_map(
        with_terms(
            Term(1000.0, (Factor("speed", 0), Factor("current", 0))),
            Term(-500.0, (Factor("speed", 0), Factor("current", 0, 2.0))),
        )
    )
    row = inverse.row(0.5)
    assert all(b >= a for a, b in pairwise(row))
    assert row[0] == 0.0
    assert 100.0 < row[-1] < 250.0
    assert inverse.current(0.5, 1e6) < 1.0


def test_a_valve_that_softens_with_current() -> None:
    softening = with_terms(Term(300.0, (Factor("speed", 0),)), Term(-100.0, (Factor("speed", 0), Factor("current", 0))))
    inverse = compute_inverse_map(softening)
    assert inverse.current(1.0, 150.0) == pytest.approx(1.5, abs=1e-6)
    assert inverse.current(-1.0, -150.0) == pytest.approx(1.5, abs=1e-6)
    assert inverse.slope(1.0, 1.0) == pytest.approx(-100.0)


def test_a_force_that_leaves_the_envelope_counts_as_its_end() -> None:
    model = replace(plain_damper(), force_envelope_N=(-1000.0, 1000.0))
    assert steady_force(model, model.make_predictor(), 1.0, 1.0) == 1000.0
    assert steady_force(model, model.make_predictor(), -1.0, 1.0) == -1000.0


def test_the_lag_is_that_of_the_model() -> None:
    """Past forces that count 0.9 at 1 kHz are a lag of -1 / ln 0.9 = 9.5 ticks."""
    assert current_lag_s(plain_damper()) == pytest.approx(0.010)


def test_models_without_two_directions_or_currents_are_refused() -> None:
    one_way = replace(plain_damper(), envelope=Envelope((-0.1, 0.1), (0.0, 2.0), (0.0, 2.0)))
    passive = replace(plain_damper(), envelope=Envelope((-0.1, 0.1), (-2.0, 2.0), (0.5, 0.5)))
    with pytest.raises(ModelError, match="both directions"):
        compute_inverse_map(one_way)
    with pytest.raises(ModelError, match=r"at 0\.5 A only"):
        compute_inverse_map(passive)


@pytest.mark.parametrize(
    ("speeds", "currents", "forces"),
    [
        ((-1.0, 1.0), (0.0, 1.0), ((0.0, -1.0),)),
        ((-1.0, 1.0), (0.0, 1.0), ((0.0, -1.0), (0.0,))),
        ((1.0, -1.0), (0.0, 1.0), ((0.0, 1.0), (0.0, -1.0))),
        ((1.0, 2.0), (0.0, 1.0), ((0.0, 1.0), (0.0, 1.0))),
        ((-1.0, 1.0), (0.0, 1.0), ((0.0, float("nan")), (0.0, 1.0))),
    ],
)
def test_a_grid_that_is_none_is_refused(
    speeds: tuple[float, ...], currents: tuple[float, ...], forces: tuple[tuple[float, ...], ...]
) -> None:
    with pytest.raises(CesError, match="inverse map"):
        InverseMap(speeds, currents, forces)


def with_terms(*terms: Term) -> Model:
    return replace(plain_damper(), body=Polynomial(terms))


def force_of_full_strokes(model: Model, speed: float, current: float, strokes: int = 6) -> float:
    """Return the force at mid-stroke of the last of full strokes at constant speed, in the speed's direction."""
    low, high = model.envelope.position_m
    step, middle, force = speed / model.sampling.rate_Hz, 0.5 * (low + high), 0.0
    run, position, way, passed = model.make_predictor(), middle, 1.0, 0
    while passed < strokes:
        if not low <= position + way * step <= high:
            way = -way
        before, position = position, position + way * step
        now = run.tick(position, way * speed, current)
        if way > 0.0 and (before - middle) * (position - middle) <= 0.0:
            passed, force = passed + 1, now
    return force


@pytest.mark.slow
def test_it_is_that_of_a_long_run_of_full_strokes() -> None:
    model = fitted_model("hydraulic")
    (slowest, fastest), currents = model.envelope.speed_m_s, model.envelope.current_A
    for speed in (0.9 * slowest, -0.05, 0.4 * fastest):
        for current in currents:
            exact = steady_force(model, model.make_predictor(), speed, current)
            assert exact == pytest.approx(force_of_full_strokes(model, speed, current), rel=0.01, abs=10.0)


def test_gas_and_viscosity_are_part_of_it() -> None:
    side = replace(NO_SIDE, viscous_Ns_m=100.0, gas_N=(100.0, 300.0))
    plain, model = (hydraulic_model(replace(LINEAR, side=one)) for one in (NO_SIDE, side))
    forces = [one.body.steady_force(one.operating_range, -0.5, 0.5) for one in (plain, model)]
    assert forces[1] - forces[0] == pytest.approx(200.0 - 50.0)


def test_friction_grows_with_the_rebound_pressure() -> None:
    """At 1 m/s and the lowest setting the pressures are 800 / 3 and 40 N; 20 N grow by 1 % per newton."""
    side = replace(NO_SIDE, friction=(FrictionElement(1e5, 20.0),))
    within = hydraulic_model(LINEAR).operating_range
    bodies = LINEAR, replace(LINEAR, side=side, friction_growth_1_N=1e-2)
    oil, all_of_it = (replace(body, creep_m_Ns=0.0).steady_force(within, 1.0, 0.0) for body in bodies)
    assert oil == pytest.approx(1.4 * 800.0 / 3.0 - 40.0, rel=1e-6)
    assert all_of_it - oil == pytest.approx(20.0 * 1.4, rel=1e-6)


@pytest.mark.parametrize(("yield_N", "expected"), [(20.0, 20.0), (40.0, 40.0), (60.0, 20.0), (90.0, 0.0)])
def test_a_spring_that_does_not_yield_in_full_strokes_is_relaxed_at_mid_stroke(yield_N: float, expected: float) -> None:
    """8000 N/m over half a stroke of 10 mm are 80 N: from -yield at the end to 80 N - yield at mid-stroke."""
    assert yield_at_mid_stroke(8000.0, yield_N, 0.01) == pytest.approx(expected)


def test_the_inverse_map_holds_it() -> None:
    model = hydraulic_model(make_hydraulic(PLAIN_VALVE))
    inverse, run = compute_inverse_map(model), model.make_predictor()
    for speed in (inverse.speeds_m_s[3], inverse.speeds_m_s[-1]):
        for current in (inverse.currents_A[0], inverse.currents_A[7]):
            force = inverse.force(speed, current)
            assert force == pytest.approx(steady_force(model, run, speed, current))
            assert force == pytest.approx(run_to_steady(model, run, speed, current), rel=0.02)


def test_slow_friction_leaves_the_steady_force_alone() -> None:
    slow = replace(LINEAR, side=replace(NO_SIDE, friction=(FrictionElement(1.0, 500.0),)))
    within = hydraulic_model(LINEAR).operating_range
    assert slow.steady_force(within, 0.5, 0.5) == LINEAR.steady_force(within, 0.5, 0.5)
