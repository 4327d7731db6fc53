"""The ticks of relaxation and chambers against their equations, solved by bisection, and against values by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random

import pytest
from physical_models import (
    CHAMBERS,
    FITTED,
    PLAIN_VALVE,
    RELAXATION,
    fitted_model,
    hostile_inputs,
    physical_model,
    random_chambers,
    random_relaxation,
)
from physical_twins import chambers_forces, relaxation_forces, settings

from ces_observer.structures import chambers, relaxation
from ces_observer.structures.curves import IncreasingCurve
from ces_observer.structures.physical import ValveRun
from ces_observer.structures.relaxation import YieldingSpring
from ces_observer.structures.structure import OperatingRange

REFERENCES = {"relaxation": relaxation_forces, "chambers": chambers_forces}
RANDOM = [(make, seed) for make in (random_relaxation, random_chambers) for seed in range(2)]


def swing(model, count=60):
    """Yield a lively course within the envelope."""
    low, high = model.envelope.current_A
    for k in range(count):
        yield (
            0.02 * math.sin(0.2 * k),
            0.6 * math.cos(0.23 * k) ** 3,
            low + (high - low) * (0.5 + 0.4 * math.sin(0.3 * k)),
        )


def agree(model, inputs):
    inputs = list(inputs)
    run = model.make_predictor()
    found, expected = [run.tick(*one) for one in inputs], REFERENCES[model.structure](model, inputs)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(map(abs, expected)))


@pytest.mark.slow
@pytest.mark.parametrize("name", FITTED)
def test_fitted_models_follow_their_equations(name):
    agree(fitted_model(name), swing(fitted_model(name)))


@pytest.mark.slow
@pytest.mark.parametrize("body", [RELAXATION, CHAMBERS], ids=["relaxation", "chambers"])
def test_small_models_follow_their_equations(body):
    agree(physical_model(body), swing(physical_model(body)))


@pytest.mark.slow
@pytest.mark.parametrize(("make", "seed"), RANDOM)
def test_random_models_follow_their_equations_on_hostile_inputs(make, seed):
    random = Random(seed)
    model = physical_model(make(random))
    agree(model, hostile_inputs(model, random, 30))


@pytest.mark.parametrize("name", FITTED)
def test_the_search_alone_gives_the_same_forces(name, monkeypatch):
    """The search takes over where following the pieces does not end; here it solves every step."""
    model = fitted_model(name)
    usual = model.make_predictor()
    forces = [usual.tick(*one) for one in swing(model)]
    for module in (chambers, relaxation):
        monkeypatch.setattr(module, "QUICK_STEPS", 1)
    searching = model.make_predictor()
    calls = []
    search = searching._search
    monkeypatch.setattr(searching, "_search", lambda *given: calls.append(given) or search(*given))
    assert [searching.tick(*one) for one in swing(model)] == pytest.approx(forces, rel=1e-10, abs=1e-8)
    assert len(calls) > 10


@pytest.mark.parametrize("name", FITTED)
def test_a_reset_brings_the_run_back_to_new(name):
    model = fitted_model(name)
    run, new = model.make_predictor(), model.make_predictor()
    for one in hostile_inputs(model, Random(1), 50):
        run.tick(*one)
    run.reset()
    assert not run.clamped
    assert [run.tick(*one) for one in swing(model)] == [new.tick(*one) for one in swing(model)]


def test_inputs_are_extrapolated_within_reach_and_clamped_beyond():
    model = physical_model(replace(RELAXATION, reach=1.5))
    runs = [model.make_predictor() for _ in range(4)]
    inside, outside, end, beyond = (run.tick(0.0, v, 0.5) for run, v in zip(runs, (1.0, 1.4, 1.5, 9.0), strict=True))
    assert inside < outside < end == beyond
    assert [run.clamped for run in runs] == [False, True, True, True]


def test_a_force_outside_its_envelope_is_held():
    within = OperatingRange(1000.0, physical_model(RELAXATION).envelope.by_signal, (-10.0, 10.0))
    for body in (RELAXATION, CHAMBERS):
        run = body.make_predictor(within)
        assert ([run.tick(0.0, 1.0, 0.5) for _ in range(20)][-1], run.held) == (10.0, True)
        run.reset()
        assert not run.held


def test_a_step_of_current_is_delayed_by_ticks_and_parts_of_them():
    run = ValveRun(replace(PLAIN_VALVE, delay_ticks=2.25), 1e-3)
    assert [run.tick(current) for current in (0.2, 1.0, 1.0, 1.0, 1.0, 1.0)] == pytest.approx(
        [0.2, 0.2, 0.2, 0.8, 1.0, 1.0]
    )


def test_a_rising_setting_lags_otherwise_than_a_falling_one():
    run = ValveRun(replace(PLAIN_VALVE, rise_s=3e-3, fall_s=1e-3), 1e-3)
    assert [run.tick(current) for current in (0.0, 1.0, 1.0)] == pytest.approx([0.0, 0.25, 0.4375])
    assert [run.tick(0.0) for _ in range(2)] == pytest.approx([0.4375 / 2.0, 0.4375 / 4.0])


def test_remanence_is_the_mean_of_three_plays():
    """Half widths 0.1, 0.3 and 0.5: at 1 they are pulled to 0.9, 0.7 and 0.5; at 0.6 only the first is pushed back."""
    run = ValveRun(replace(PLAIN_VALVE, hysteresis_A=0.3), 1e-3)
    assert [run.tick(current) for current in (0.0, 1.0)] == pytest.approx([0.0, 0.7])
    assert run.tick(0.6) == pytest.approx((0.7 + 0.7 + 0.5) / 3.0)
    assert run.tick(0.0) == pytest.approx((0.1 + 0.3 + 0.5) / 3.0)


def test_a_characteristic_goes_on_straight_and_stays_within_0_and_1():
    path = replace(PLAIN_VALVE, characteristic=IncreasingCurve((0.2, 0.5, 0.8), (0.1, 0.2, 0.8)))
    for current, setting in ((-5.0, 0.0), (0.05, 0.05), (0.35, 0.15), (0.85, 0.9), (1.5, 1.0)):
        assert ValveRun(path, 1e-3).tick(current) == pytest.approx(setting)
        assert path.steady(current) == pytest.approx(setting)


def test_the_valve_follows_its_reference_on_hostile_currents():
    for seed in range(20):
        random = Random(seed)
        model = physical_model(random_relaxation(random))
        currents = [min(max(one[2], -1.0), 2.0) for one in hostile_inputs(model, random, 200)]
        run = ValveRun(model.body.valve, 1e-3)
        assert [run.tick(c) for c in currents] == pytest.approx(settings(model.body.valve, currents, 1e-3), abs=1e-12)


def test_a_restart_away_from_mid_stroke_does_not_bias_a_relaxation_model():
    """A soft spring that never yields keeps its start: a run started late must agree with the whole run."""
    rows = len(RELAXATION.map.rows)
    soft, stiff = YieldingSpring(2400.0, (500.0,) * rows), YieldingSpring(1e6, (60.0,) * rows)
    side = replace(RELAXATION.side, position_m=(-0.02, 0.0, 0.02), gas_N=(0.0, 0.0, 0.0))
    model = physical_model(replace(RELAXATION, springs=(stiff, soft), side=side))
    assert model.body.restoring == ((0.0, 0.0), (2400.0, 500.0))
    rate = model.sampling.rate_Hz
    inputs = [
        (x, 0.02 * 20.0 * math.cos(20.0 * t), 0.5)
        for t in (k / rate for k in range(3000))
        for x in (0.02 * math.sin(20.0 * t),)
    ]
    late = max(range(1000, 1400), key=lambda k: inputs[k][0])
    whole, part = (
        list(map(run.tick, *zip(*some, strict=True)))
        for run, some in ((model.make_predictor(), inputs), (model.make_predictor(), inputs[late:]))
    )
    assert whole[late + 500 :] == pytest.approx(part[500:], abs=2.0)
