"""The exported tick on hostile inputs: as in Python, bit for bit, finite, and within the bound that is proved."""

import math
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from exported_c import hostile
from hydraulic_models import ENVELOPE, GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from physical_examples import make_valve
from recurrent_models import make_recurrent, recurrent_model
from tick_forms import compile_export, python_ticks, run_ticks

from ces_observer.structures.curves import Bypass, FlowMap
from ces_observer.structures.physical import FrictionElement, SideForces, widen

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc")]
LINE = FlowMap((0.0, 1.0), ((0.0, 2000.0),))  # as few nodes as a file may hold
NO_SIDE = SideForces(0.0, 0.0, 0.0, 0.0, (0.0, 1.0), (0.0, 0.0), ())
SPRINGS = tuple(FrictionElement(*one) for one in ((1e12, 0.0, 5.0), (1e5, 18.0), (3e4, 9.0, 4.0), (1e-9, 1e9)))
AT_ONCE = {"piston_s": 0.0, "base_s": 0.0, "external_s": 0.0}
NONE = ("area_ratio", "air", "fade_1_W", "mount_m_N", "compression_growth_1_m", "rebound_growth_1_m")
BODIES = {
    "usual": {},
    "groove": {"bypass": GROOVE, "kind": "monotube"},
    "no lags": AT_ONCE,
    "lags": {"piston_s": 0.05, "base_s": 1.0, "external_s": 3e-3, "laminar_N": 1e-6},
    "groove without lags": {**AT_ONCE, "bypass": Bypass((-0.01, 0.01), (1e-9, 0.5)), "fade_1_W": -0.5},
    "least": {
        **AT_ONCE,
        **dict.fromkeys(("piston", "base", "external"), LINE),
        **dict.fromkeys(NONE, 0.0),
        "side": NO_SIDE,
    },
    "springs": {**AT_ONCE, "creep_m_Ns": 1e-4, "side": replace(NO_SIDE, friction=SPRINGS)},
    "growths": {"compression_growth_1_m": 300.0, "rebound_growth_1_m": -300.0, "mount_m_N": 0.0},
    "held pressures": {"most_N": 50.0, "air": 1000.0, "reservoir_N": 20.0},
}
WIDE = (-1e9, 1e9)
MODELS = {
    **{
        name: lambda changes=changes: hydraulic_model(make_hydraulic(make_valve(0.3), **changes))
        for name, changes in BODIES.items()
    },
    **{f"random {seed}": lambda seed=seed: hydraulic_model(random_hydraulic(Random(seed))) for seed in range(12)},
    "recurrent": lambda: recurrent_model(force_envelope_N=WIDE),
    "recurrent without a current": lambda: recurrent_model(make_recurrent(2, 3, current=False), force_envelope_N=WIDE),
}


@pytest.fixture(scope="module", params=["usual", "groove"])
def network(request, tmp_path_factory):
    """Return a hydraulic model and its compiled C."""
    model = MODELS[request.param]()
    return model, compile_export(tmp_path_factory.mktemp("model"), model)


def assert_equal(forces, expected) -> None:
    np.testing.assert_array_equal(forces.view(np.int64), expected.view(np.int64))


@pytest.mark.parametrize("name", MODELS)
def test_ticks_are_those_of_python_and_within_the_bound(tmp_path, name) -> None:
    model, dice = MODELS[name](), np.random.default_rng(2)
    inputs = hostile(2000, 2)
    if name.startswith("random"):
        for values in inputs:
            values[dice.random(len(values)) < 0.01] = dice.choice([-1e300, 1e300, -math.inf, math.inf, 1e-12, 0.0])
    library = compile_export(tmp_path, model)
    assert_equal(run_ticks(library, np.column_stack(inputs)), python_ticks(model, np.column_stack(inputs)))
    forces, bounds = run_ticks(library, np.column_stack(hostile(100_000, 4))), model.certify().bounds
    assert np.abs(forces).max() <= bounds.get("force_bound_any_input_N", bounds["force_bound_N"])


def test_a_force_beyond_its_envelope_is_held(tmp_path, network) -> None:
    model = replace(network[0], force_envelope_N=(-200.0, 300.0))
    forces = run_ticks(compile_export(tmp_path, model), np.column_stack(hostile(1000, 5)))
    assert (forces.min(), forces.max()) == model.force_envelope_N


def test_inputs_are_used_up_to_the_reach_and_clamped_beyond(network) -> None:
    model, library = network
    wide = widen(ENVELOPE.by_signal, model.body.reach)
    for place, signal in enumerate(ENVELOPE.by_signal):
        still = np.tile([0.0, 0.1, 0.5], (3, 300, 1))
        still[:, :, place] = [[ENVELOPE.by_signal[signal][1]], [wide[signal][1]], [3.0 * wide[signal][1]]]
        inside, outside, reach = (run_ticks(library, rows) for rows in still)
        np.testing.assert_array_equal(outside, reach)
        assert (outside[-1] == inside[-1]) == (signal == "current")  # the characteristic ends with the envelope


@pytest.mark.parametrize("place", range(3))
def test_a_tick_without_a_number_has_no_force(network, place) -> None:
    model, library = network
    inputs = np.column_stack(hostile(500, 6))
    inputs[100, place] = math.nan
    forces = run_ticks(library, inputs)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(forces)), [100])
    assert_equal(forces[101:], python_ticks(model, inputs[101:]))
