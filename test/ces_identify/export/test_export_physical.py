"""Exported relaxation models and chambers are the estimator's twins, extrapolate as it does, and solve every step."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from exported_c import (
    CODES,
    INPUTS,
    c_steps,
    c_ticks,
    compile_c,
    python_steps,
    python_ticks,
    seeded,
    undefined_and_defined,
)
from physical_examples import ENVELOPE, SAMPLING, make_chambers, make_model, make_relaxation, make_valve

from ces_identify.export.export_c import export_c
from ces_observer.model import parse_model
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.physical import SideForces, ValvePath, widen

PLAIN_VALVE = make_valve(hysteresis_A=0.0)
SLOW = replace(SAMPLING, rate_Hz=400.0, bandwidth_Hz=40.0, order=2)
LONG_GAP = replace(SAMPLING, rate_Hz=1333.3, max_gap_s=0.2, warm_up_s=0.0)
SMALLEST = FlowMap((0.0, 1.0), ((0.0, 500.0), (0.0, 2000.0)))
LARGEST = FlowMap(
    tuple((k - 20) / 40 for k in range(64)),
    tuple(tuple((k - 20) * (20.0 + row) + (k > 25) * 9.0 * row for k in range(64)) for row in range(16)),
)
LINE = IncreasingCurve((-100.0, 0.0), (-0.1, 0.0))
MODELS = {
    "relaxation": make_model(make_relaxation(make_valve())),
    "relaxation, delayed": make_model(make_relaxation(make_valve(5.7)), LONG_GAP),
    "relaxation, no springs": make_model(make_relaxation(PLAIN_VALVE, springs=0), SLOW),
    "relaxation, largest map": make_model(replace(make_relaxation(make_valve(1.0), springs=0), map=LARGEST)),
    "chambers": make_model(make_chambers(make_valve())),
    "chambers, delayed": make_model(make_chambers(make_valve(0.3), friction=3, friction_growth_1_N=0.0), LONG_GAP),
    "chambers, no friction": make_model(make_chambers(PLAIN_VALVE, friction=0), SLOW),
    "chambers, largest map": make_model(replace(make_chambers(make_valve(2.0)), map=LARGEST)),
    "chambers, smallest": make_model(replace(make_chambers(PLAIN_VALVE), map=SMALLEST, check=LINE, refill=LINE)),
}
RELATIVE = 1e-9  # of the largest force that is proved to be possible


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return the compiled library of a model of MODELS, by its name."""
    ready = {}

    def find(name):
        if name not in ready:
            ready[name] = compile_c(tmp_path_factory.mktemp("model"), MODELS[name], MODELS[name].certify())
        return ready[name]

    return find


def close(model, forces, expected):
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=RELATIVE * model.force_envelope_N[1])


# ---------------------------------------------------------------------------------------------------- equal forces


@pytest.mark.needs("cc")
@pytest.mark.parametrize("shape", INPUTS)
@pytest.mark.parametrize("name", MODELS)
def test_forces_and_reasons_are_the_estimators(library, name, shape):
    samples = seeded(shape)
    rows, reasons = c_steps(library(name), *samples)
    expected, expected_reasons = python_steps(MODELS[name], *samples)
    np.testing.assert_array_equal(reasons, expected_reasons)
    np.testing.assert_array_equal(rows[:, 3], expected[:, 3])
    close(MODELS[name], rows[:, 0], expected[:, 0])
    np.testing.assert_allclose(rows[:, 1:3], expected[:, 1:3], rtol=1e-9, atol=1e-14)


def hostile(count, seed):
    """Return inputs that jump between and beyond the ends of their ranges, each held for random times."""
    dice, inputs = np.random.default_rng(seed), []
    for low, high in ENVELOPE.by_signal.values():
        width = high - low
        ends = dice.choice([low, high, low - 1.5 * width, high + 1.5 * width, high + 0.4 * width, 0.0], count)
        drawn = np.where(dice.random(count) < 0.7, ends, dice.uniform(low - 1.5 * width, high + 1.5 * width, count))
        new = dice.random(count) < dice.choice([0.02, 0.3, 1.0])
        inputs.append(drawn[np.maximum.accumulate(np.where(new, np.arange(count), 0))])
    return inputs


@pytest.mark.needs("cc")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_ticks_are_equal_for_hostile_inputs(library, name, seed):
    inputs = hostile(2000, seed)
    forces = c_ticks(library(name), *inputs)
    assert np.isfinite(forces).all()
    close(MODELS[name], forces, python_ticks(MODELS[name], *inputs))


@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_a_million_hostile_ticks_stay_within_the_proved_bound(library, name):
    forces = c_ticks(library(name), *hostile(1_000_000, 4))
    assert np.abs(forces).max() <= MODELS[name].certify().bounds["force_bound_any_input_N"]


@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_a_force_beyond_its_envelope_is_withheld_and_the_past_is_cleared(tmp_path, name):
    model = replace(MODELS[name], force_envelope_N=(-200.0, 300.0))
    inputs = hostile(2000, 5)
    forces, expected = c_ticks(compile_c(tmp_path, model), *inputs), python_ticks(model, *inputs)
    assert np.isnan(expected).any()
    assert np.isfinite(expected).any()
    close(model, forces, expected)
    samples = seeded(INPUTS[0])
    reasons = c_steps(compile_c(tmp_path, model), *samples)[1]
    np.testing.assert_array_equal(reasons, python_steps(model, *samples)[1])
    assert CODES["force left its envelope"] in reasons


# ---------------------------------------------------------------------------------------- outside of the envelope


@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_inputs_are_used_up_to_the_reach_and_clamped_beyond(library, name):
    wide = widen(ENVELOPE.by_signal, MODELS[name].body.reach)
    still = [0.0, 0.1, 0.5]
    for place, signal in enumerate(ENVELOPE.by_signal):
        inside, outside, reach = (
            c_ticks(library(name), *([at if k == place else v] * 300 for k, v in enumerate(still)))
            for at in (ENVELOPE.by_signal[signal][1], wide[signal][1], 3.0 * wide[signal][1])
        )
        np.testing.assert_array_equal(outside, reach)
        assert (outside[-1] == inside[-1]) == (signal == "current")  # the characteristic ends with the envelope


@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", ["relaxation", "chambers"])
@pytest.mark.parametrize("place", range(3))
def test_a_tick_without_a_number_has_no_force(library, name, place):
    inputs = hostile(500, 6)
    inputs[place][100] = math.nan
    forces = c_ticks(library(name), *inputs)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(forces)), [100])
    close(MODELS[name], forces[101:], python_ticks(MODELS[name], *(values[101:] for values in inputs)))


# --------------------------------------------------------------------------------------------- awkward curves


def steep(dice, count, width, height, below):
    """Return a curve through the origin whose slopes differ by factors up to a million."""
    drops = sorted(width * dice.random() ** 3 + 1e-6 for _ in range(count))
    rises = [height * 10.0 ** dice.uniform(-6.0, 0.0) for _ in range(count)]
    left = [(-width * (k + 1), -height * (k + 1)) for k in reversed(range(below))]
    right = [(drop, sum(rises[: k + 1])) for k, drop in enumerate(drops)]
    return IncreasingCurve(*zip(*left, (0.0, 0.0), *right, strict=True))


def awkward(seed):
    """Return chambers of unlikely curves and compliances, with nothing else in the model."""
    dice = random.Random(seed)
    softest = steep(dice, 20, 2.0, 3000.0, 2)
    return replace(
        make_chambers(make_valve()),
        valve=ValvePath(IncreasingCurve((0.0, 1.0), (0.0, 1.0)), 0.0, 0.0, 0.0, 0.0),
        area_ratio=dice.uniform(0.0, 2.0),
        compression_m_N=10.0 ** dice.uniform(-9, -5),
        rebound_m_N=10.0 ** dice.uniform(-9, -5),
        mount_m_N=dice.choice([0.0, 10.0 ** dice.uniform(-9, -5)]),
        check=steep(dice, 20, 3000.0, 3.0, 2),
        refill=steep(dice, 10, 3000.0, 3.0, 1),
        map=FlowMap(softest.at, (softest.values, tuple(2.0 * value for value in softest.values))),
        side=SideForces(0.0, 0.0, 0.0, 0.0, (0.0, 1.0), (0.0, 0.0), ()),
    )


def bisect(rising, low=-1e9, high=1e9):
    for _ in range(90):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if rising(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high)


def solve(body, drive, setting, before, interval):
    """Solve a step of the chambers by bisection of the rebound pressure, each time with the other one by bisection."""
    ratio, (old_c, old_r) = 1.0 + body.area_ratio, before
    valve = IncreasingCurve(body.map.blend(setting), body.map.at)
    mounts = lambda c, r: body.mount_m_N * (ratio * (c - old_c) - (r - old_r))  # noqa: E731

    def compression(r):
        def left(c):
            flows = body.check(c - r) - body.refill(-c) - ratio * drive
            return body.compression_m_N * (c - old_c) + ratio * mounts(c, r) + interval * flows

        return bisect(left)

    def left(r):
        c = compression(r)
        flows = valve(r) - body.check(c - r) + drive
        return body.rebound_m_N * (r - old_r) - mounts(c, r) + interval * flows

    rebound = bisect(left)
    return compression(rebound), rebound


@pytest.mark.needs("cc")
@pytest.mark.parametrize("seed", range(6))
def test_every_step_of_the_chambers_is_solved(tmp_path, seed):
    body = awkward(seed)
    model = replace(MODELS["chambers"], body=body, force_envelope_N=(-1e9, 1e9))
    _, speed, current = hostile(12, seed)
    speed, current = np.clip(speed, -1.5, 1.4), np.clip(current, 0.1, 0.9)
    forces, pressures, expected = c_ticks(compile_c(tmp_path, model), 0.0 * speed, speed, current), (0.0, 0.0), []
    for v, i in zip(speed, current, strict=True):
        pressures = solve(body, v, i, pressures, 1e-3)
        expected.append((1.0 + body.area_ratio) * pressures[0] - pressures[1])
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=RELATIVE * np.abs(expected).max())


# ------------------------------------------------------------------------------------------------------- the text


@pytest.mark.needs("cc", "nm")
@pytest.mark.parametrize("name", ["relaxation, delayed", "chambers, delayed"])
def test_it_needs_nothing_but_math_and_has_no_globals(tmp_path, name):
    compile_c(tmp_path, MODELS[name])
    needed, kinds = undefined_and_defined(tmp_path)
    assert needed <= {"cos", "exp", "floor"}
    assert not {n for n, kind in kinds.items() if kind in "bBdDC"}
    assert {n for n, kind in kinds.items() if kind == "T"} == {
        "model_reset", "model_step", "model_tick", "model_past_reset"
    }  # fmt: skip


@pytest.mark.parametrize(("name", "noun"), [("relaxation", "relaxation model"), ("chambers", "model of two chambers")])
def test_comments_name_the_structure_and_both_bounds(name, noun):
    model = MODELS[name]
    proof = model.certify()
    source, header = export_c(model, "model", "model", proof)
    for text in (source, header):
        assert noun in text
        assert "polynomial" not in text
    assert f"never exceeds {proof.envelope_N} N for inputs within the envelope" in header
    assert f"{proof.force_bound_N} N for any input" in header
    assert "used as they are up to 2.0 times" in header


def test_a_model_file_gives_the_same_code():
    for model in MODELS.values():
        again = parse_model(model.to_json(), "model.json")
        assert export_c(again, "m", "m", model.certify()) == export_c(model, "m", "m", model.certify())
