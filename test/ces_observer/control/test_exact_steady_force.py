"""The exact steady force of models with physics inside: that of a long run of full strokes, and of the inverse map."""

from __future__ import annotations

from dataclasses import replace

import pytest
from physical_models import CHAMBERS, FITTED, NO_SIDE, RELAXATION, fitted_model, physical_model

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
@pytest.mark.parametrize("name", FITTED)
def test_it_is_that_of_a_long_run_of_full_strokes(name: str) -> None:
    model = fitted_model(name)
    low, high = model.envelope.current_A
    for speed in (-1.4, -0.05, 0.4):
        for current in (low, high):
            exact = model.body.steady_force(model.operating_range, speed, current)
            assert exact == pytest.approx(force_of_full_strokes(model, speed, current), rel=0.01, abs=10.0)


def test_a_leak_lets_less_pass_the_valve() -> None:
    """q + leak y = v; between the nodes at 0.1 and 1 m/s of the soft curve, y = 100 + (q - 0.1) 300 / 0.9."""
    leaky = physical_model(replace(RELAXATION, leak_m_Ns=1e-4, springs=()))
    slope = 300.0 / 0.9
    expected = (100.0 + (0.5 - 0.1) * slope) / (1.0 + 1e-4 * slope)
    assert leaky.body.steady_force(leaky.operating_range, 0.5, 0.0) == pytest.approx(expected, rel=1e-6)


def test_gas_and_viscosity_are_part_of_it() -> None:
    side = replace(NO_SIDE, viscous_Ns_m=100.0, gas_N=(100.0, 300.0))
    plain, model = (physical_model(replace(RELAXATION, side=one)) for one in (NO_SIDE, side))
    forces = [one.body.steady_force(one.operating_range, -0.5, 0.5) for one in (plain, model)]
    assert forces[1] - forces[0] == pytest.approx(200.0 - 50.0)


def test_friction_grows_with_the_rebound_pressure() -> None:
    """At -0.1 m/s the hard curve asks for 2500 N or less of pressure; the friction of 20 N grows by 1e-4 per newton."""
    still = replace(CHAMBERS, side=NO_SIDE)
    within = physical_model(CHAMBERS).operating_range
    oil, all_of_it = (body.steady_force(within, -0.1, 0.0) for body in (still, CHAMBERS))
    assert oil < -200.0
    assert all_of_it - oil == pytest.approx(-20.0 * (1.0 - 1e-4 * oil), rel=0.02)


@pytest.mark.parametrize(("yield_N", "expected"), [(20.0, 20.0), (40.0, 40.0), (60.0, 20.0), (90.0, 0.0)])
def test_a_spring_that_does_not_yield_in_full_strokes_is_relaxed_at_mid_stroke(yield_N: float, expected: float) -> None:
    """8000 N/m over half a stroke of 10 mm are 80 N: from -yield at the end to 80 N - yield at mid-stroke."""
    assert yield_at_mid_stroke(8000.0, yield_N, 0.01) == pytest.approx(expected)


def test_the_inverse_map_holds_it() -> None:
    model = fitted_model("chambers")
    inverse, run = compute_inverse_map(model), model.make_predictor()
    for speed in (inverse.speeds_m_s[3], inverse.speeds_m_s[-1]):
        for current in (inverse.currents_A[0], inverse.currents_A[7]):
            force = inverse.force(speed, current)
            assert force == pytest.approx(steady_force(model, run, speed, current))
            assert force == pytest.approx(run_to_steady(model, run, speed, current), rel=0.01)


def test_a_force_beyond_the_force_envelope_counts_as_its_end() -> None:
    model = replace(physical_model(RELAXATION), force_envelope_N=(-300.0, 200.0))
    run = model.make_predictor()
    assert [steady_force(model, run, speed, 1.0) for speed in (-1.0, 1.0)] == [-300.0, 200.0]


def test_slow_friction_leaves_the_chambers_steady_force_alone() -> None:
    slow = replace(CHAMBERS, side=replace(NO_SIDE, friction=(FrictionElement(1.0, 500.0),)))
    within = physical_model(CHAMBERS).operating_range
    still = replace(CHAMBERS, side=NO_SIDE)
    assert slow.steady_force(within, 0.5, 0.5) == still.steady_force(within, 0.5, 0.5)
