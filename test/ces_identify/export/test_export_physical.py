"""Exported relaxation models and chambers stay within their bounds, extrapolate as they say, and solve every step."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from exported_c import CODES, INPUTS, c_steps, c_ticks, compile_c, hostile, python_steps, python_ticks, seeded
from physical_examples import ENVELOPE, make_chambers, make_model, make_relaxation, make_valve

from ces_identify.export.export_c import export_c
from ces_observer.estimator import UNBOUNDED
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.physical import SideForces, ValvePath, widen

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc")]


@pytest.fixture(scope="module", params=["relaxation", "chambers"])
def twins(request, tmp_path_factory):
    """Return a model and its compiled library."""
    valve = make_valve()
    model = make_model(make_relaxation(valve) if request.param == "relaxation" else make_chambers(valve))
    return model, compile_c(tmp_path_factory.mktemp("model"), model)


def close(model, forces, expected) -> None:
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=1e-9 * model.force_envelope_N[1])


def test_hostile_ticks_stay_within_the_proved_bound(twins) -> None:
    model, library = twins
    forces = c_ticks(library, *hostile(200_000, 4))
    assert np.abs(forces).max() <= model.certify().bounds["force_bound_any_input_N"]
    inputs = hostile(2000, 2)
    close(model, c_ticks(library, *inputs), python_ticks(model, *inputs))


def test_a_force_beyond_its_envelope_is_held_without_a_new_warm_up(tmp_path, twins) -> None:
    model = replace(twins[0], force_envelope_N=(-200.0, 300.0))
    library, inputs = compile_c(tmp_path, model), hostile(1000, 5)
    forces, expected = c_ticks(library, *inputs), python_ticks(model, *inputs)
    assert (expected.min(), expected.max()) == model.force_envelope_N
    close(model, forces, expected)
    samples = seeded(INPUTS[0])
    reasons = c_steps(library, *samples)[1]
    np.testing.assert_array_equal(reasons, python_steps(model, *samples)[1])
    assert CODES[UNBOUNDED] not in reasons


def test_inputs_are_used_up_to_the_reach_and_clamped_beyond(twins) -> None:
    model, library = twins
    wide = widen(ENVELOPE.by_signal, model.body.reach)
    still = [0.0, 0.1, 0.5]
    for place, signal in enumerate(ENVELOPE.by_signal):
        inside, outside, reach = (
            c_ticks(library, *([at if k == place else v] * 300 for k, v in enumerate(still)))
            for at in (ENVELOPE.by_signal[signal][1], wide[signal][1], 3.0 * wide[signal][1])
        )
        np.testing.assert_array_equal(outside, reach)
        assert (outside[-1] == inside[-1]) == (signal == "current")  # the characteristic ends with the envelope


@pytest.mark.parametrize("place", range(3))
def test_a_tick_without_a_number_has_no_force(twins, place) -> None:
    model, library = twins
    inputs = hostile(500, 6)
    inputs[place][100] = math.nan
    forces = c_ticks(library, *inputs)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(forces)), [100])
    close(model, forces[101:], python_ticks(model, *(values[101:] for values in inputs)))


def test_comments_name_the_structure_and_both_bounds(twins) -> None:
    model = twins[0]
    proof = model.certify()
    source, header = export_c(model, "model", "model", proof)
    noun = "model of two chambers" if "chambers" in model.structure else "relaxation model"
    for text in (source, header):
        assert noun in text
        assert "polynomial" not in text
    assert f"never exceeds {proof.envelope_N} N for inputs within the envelope" in header
    assert f"{proof.force_bound_N} N for any input" in header
    assert "used as they are up to 2.0 times" in header


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


@pytest.mark.parametrize("seed", range(2))
def test_every_step_of_the_chambers_is_solved(tmp_path, seed) -> None:
    body = awkward(seed)
    model = replace(make_model(make_chambers(make_valve())), body=body, force_envelope_N=(-1e9, 1e9))
    _, speed, current = hostile(12, seed)
    speed, current = np.clip(speed, -1.5, 1.4), np.clip(current, 0.1, 0.9)
    forces, pressures, expected = c_ticks(compile_c(tmp_path, model), 0.0 * speed, speed, current), (0.0, 0.0), []
    for v, i in zip(speed, current, strict=True):
        pressures = solve(body, v, i, pressures, 1e-3)
        expected.append((1.0 + body.area_ratio) * pressures[0] - pressures[1])
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
