"""The exact steady force of models with physics inside: that of a long run of full strokes, and of the inverse map."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hydraulic_models import hydraulic_model, make_hydraulic
from physical_models import LINEAR, NO_SIDE, PLAIN_VALVE, fitted_model

from ces_observer.control.inverse_map import compute_inverse_map, run_to_steady, steady_force
from ces_observer.model import Model
from ces_observer.structures.physical import FrictionElement, yield_at_mid_stroke


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


def test_a_force_beyond_the_force_envelope_counts_as_its_end() -> None:
    model = replace(hydraulic_model(LINEAR), force_envelope_N=(-300.0, 200.0))
    run = model.make_predictor()
    assert [steady_force(model, run, speed, 0.9) for speed in (-1.0, 1.0)] == [-300.0, 200.0]


def test_slow_friction_leaves_the_steady_force_alone() -> None:
    slow = replace(LINEAR, side=replace(NO_SIDE, friction=(FrictionElement(1.0, 500.0),)))
    within = hydraulic_model(LINEAR).operating_range
    assert slow.steady_force(within, 0.5, 0.5) == LINEAR.steady_force(within, 0.5, 0.5)
