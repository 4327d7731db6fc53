"""Exported hydraulic networks solve every step as in Python, whatever their curves, and stay within their bound."""

import math
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from bands import BAND
from exported_c import (
    CODES,
    INPUTS,
    assert_same,
    c_steps,
    c_ticks,
    compile_c,
    hostile,
    python_steps,
    python_ticks,
    seeded,
    two_models,
    with_delay,
)
from hydraulic_models import ENVELOPE, GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from physical_examples import make_valve

from ces_identify.export.export_c import export_c
from ces_observer.estimator import UNBOUNDED
from ces_observer.structures.curves import Bypass, FlowMap
from ces_observer.structures.physical import FrictionElement, SideForces, widen

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc")]
LINE = FlowMap((0.0, 1.0), ((0.0, 2000.0),))  # as few nodes as a file may hold
NO_SIDE = SideForces(0.0, 0.0, 0.0, 0.0, (0.0, 1.0), (0.0, 0.0), ())
SPRINGS = tuple(FrictionElement(*one) for one in ((1e12, 0.0, 5.0), (1e5, 18.0), (3e4, 9.0, 4.0), (1e-9, 1e9)))
AT_ONCE = {"piston_s": 0.0, "base_s": 0.0, "external_s": 0.0}
BODIES = {
    "usual": {},
    "groove": {"bypass": GROOVE, "kind": "monotube"},
    "no lags": AT_ONCE,
    "lags": {"piston_s": 0.05, "base_s": 1.0, "external_s": 3e-3, "laminar_N": 1e-6},
    "groove without lags": {**AT_ONCE, "bypass": Bypass((-0.01, 0.01), (1e-9, 0.5)), "fade_1_W": -0.5},
    "least": {
        **AT_ONCE,
        **dict.fromkeys(("piston", "base", "external"), LINE),
        **dict.fromkeys(
            ("area_ratio", "air", "fade_1_W", "mount_m_N", "compression_growth_1_m", "rebound_growth_1_m"), 0.0
        ),
        "side": NO_SIDE,
    },
    "springs": {**AT_ONCE, "creep_m_Ns": 1e-4, "side": replace(NO_SIDE, friction=SPRINGS)},
    "growths": {"compression_growth_1_m": 300.0, "rebound_growth_1_m": -300.0, "mount_m_N": 0.0},
    "held pressures": {"most_N": 50.0, "air": 1000.0, "reservoir_N": 20.0},
}


def body(name):
    return make_hydraulic(make_valve(0.3), **BODIES[name])


def assert_close(forces, expected) -> None:
    np.testing.assert_allclose(forces, expected, rtol=0.0, atol=1e-9 * np.nanmax(np.abs(expected)))


@pytest.fixture(scope="module", params=["usual", "groove"])
def twins(request, tmp_path_factory):
    """Return a model and its compiled library."""
    model = hydraulic_model(body(request.param))
    return model, compile_c(tmp_path_factory.mktemp("model"), model)


@pytest.mark.parametrize("name", BODIES)
def test_ticks_are_those_of_python(tmp_path, name) -> None:
    model, inputs = hydraulic_model(body(name)), hostile(3000, 2)
    forces = c_ticks(compile_c(tmp_path, model), *inputs)
    assert_close(forces, python_ticks(model, *inputs))
    assert np.isfinite(forces).all()


@pytest.mark.parametrize("seed", range(12))
def test_ticks_of_random_networks_are_those_of_python(tmp_path, seed) -> None:
    model, inputs = hydraulic_model(random_hydraulic(Random(seed))), hostile(2000, seed)
    dice = np.random.default_rng(seed)
    for values in inputs:
        values[dice.random(len(values)) < 0.01] = dice.choice([-1e300, 1e300, -math.inf, math.inf, 1e-12, 0.0])
    assert_close(c_ticks(compile_c(tmp_path, model), *inputs), python_ticks(model, *inputs))


def test_hostile_ticks_stay_within_the_proved_bound(twins) -> None:
    model, library = twins
    forces = c_ticks(library, *hostile(200_000, 4))
    assert np.abs(forces).max() <= model.certify().bounds["force_bound_any_input_N"]


def test_at_rest_rounding_moves_nothing(twins) -> None:
    """The sign of a drop that has died out is that of rounding errors; it must not say what the next stroke meets."""
    model, library = twins
    ticks = np.arange(4000.0)
    moving = np.where(ticks % 1000.0 < 300.0, 0.4 * np.sin(0.05 * ticks), 0.0)
    inputs = 0.0 * ticks, moving, 0.5 + 0.0 * ticks
    assert_close(c_ticks(library, *inputs), python_ticks(model, *inputs))


def test_a_force_beyond_its_envelope_is_held_without_a_new_warm_up(tmp_path, twins) -> None:
    model = replace(twins[0], force_envelope_N=(-200.0, 300.0))
    library, inputs = compile_c(tmp_path, model), hostile(1000, 5)
    forces, expected = c_ticks(library, *inputs), python_ticks(model, *inputs)
    assert (expected.min(), expected.max()) == model.force_envelope_N
    assert_close(forces, expected)
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
    assert_close(forces[101:], python_ticks(model, *(values[101:] for values in inputs)))


ESTIMATORS = {
    "at once": lambda: replace(hydraulic_model(body("usual")), band=BAND),
    "a delay": lambda: with_delay(replace(hydraulic_model(body("groove")), band=BAND), 0.003),
    "both": lambda: two_models(hydraulic_model(body("usual")), hydraulic_model(body("groove")), 0.003),
}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_estimators_around_them_are_those_of_python(tmp_path, name) -> None:
    model = ESTIMATORS[name]()
    library = compile_c(tmp_path, model)
    for shape in (INPUTS[0], INPUTS[-1]):
        samples = seeded(shape)
        assert_same(c_steps(library, *samples), python_steps(model, *samples), 1e-9 * 5000.0, shape.__name__)


def test_comments_name_the_structure_and_both_bounds(twins) -> None:
    model = twins[0]
    proof = model.certify()
    source, header = export_c(model, "model", "model", proof)
    for text in (source, header):
        assert "hydraulic network" in text
        assert "polynomial" not in text
    assert f"never exceeds {proof.envelope_N} N for inputs within the envelope" in header
    assert f"{proof.force_bound_N} N for any input" in header
    assert "used as they are up to 2.0 times" in header
