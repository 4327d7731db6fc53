"""Hostile inputs: every force of a hydraulic network is finite, within its proved bound, and the same bit for bit.

Inputs jump between the ends of the reach and beyond, alternate, stand still and swing (`hostile_inputs`). All of them
go through the batch run, in which a step that does not converge gives no number. The first of each model also go
through plain Python, whose state must be that of the compiled tick in every place.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hydraulic_models import hydraulic_model, make_hydraulic, random_hydraulic
from physical_examples import make_valve
from physical_models import FITTED, fitted_model, hostile_inputs
from samplings import make_sampling

from ces_identify.numerics.core import compile_tick
from ces_identify.structures import run_batch
from ces_observer.model import Model, parse_model
from ces_observer.structures.curves import Bypass, FlowMap
from ces_observer.structures.hydraulic import EDGES, FrictionElement, SideForces
from ces_observer.tick.hydraulic import hydraulic_reset, hydraulic_tick

TICKS, COMPARED = 20_000, 300
LINE = FlowMap((0.0, 1.0), ((0.0, 2000.0),))  # as few nodes as a file may hold
NO_SIDE = SideForces(0.0, 0.0, 0.0, 0.0, (0.0, 1.0), (0.0, 0.0), ())
SPRINGS = tuple(FrictionElement(*one) for one in ((1e12, 0.0, 5.0), (1e5, 18.0), (3e4, 9.0, 4.0), (1e-9, 1e8)))
AT_ONCE = {"piston_s": 0.0, "base_s": 0.0, "external_s": 0.0}
NONE = ("area_ratio", "air", "fade_1_W", "mount_m_N", "compression_growth_1_m", "rebound_growth_1_m")
LEAST = {**dict.fromkeys(EDGES, LINE), **dict.fromkeys(NONE, 0.0), "side": NO_SIDE}
BODIES = {
    "lags": {"piston_s": 0.05, "base_s": 1.0, "external_s": 3e-3, "laminar_N": 1e-6},
    "groove without lags": {**AT_ONCE, "bypass": Bypass((-0.01, 0.01), (1e-9, 0.5)), "fade_1_W": -0.5},
    "least": {**AT_ONCE, **LEAST},
    "springs": {**AT_ONCE, "creep_m_Ns": 1e-4, "side": replace(NO_SIDE, friction=SPRINGS)},
    "growths": {"compression_growth_1_m": 100.0, "rebound_growth_1_m": -100.0, "mount_m_N": 0.0},
    "held pressures": {"most_N": 50.0, "air": 1000.0, "reservoir_N": 20.0},
}


def model_of(which: str | int) -> Model:
    """Return a fitted model, or a random one as read from its file, without a force envelope that matters."""
    if which in BODIES:
        model = hydraulic_model(make_hydraulic(make_valve(0.3), **BODIES[which]))
    elif isinstance(which, str):
        model = fitted_model(which)
    else:
        random = Random(1000 + which)
        model = hydraulic_model(random_hydraulic(random), make_sampling(random.choice((200.0, 1000.0, 4000.0))))
    return replace(parse_model(model.to_json(), "m.json"), force_envelope_N=(-1e300, 1e300))


@pytest.mark.slow
@pytest.mark.parametrize("which", [*FITTED, *BODIES, *range(8)])
def test_forces_are_finite_and_within_the_bound(which: str | int) -> None:
    model = model_of(which)
    inputs = np.array(list(hostile_inputs(model, Random(7), TICKS))).T
    forces, held = run_batch(model, inputs, np.array([[0, TICKS]]))
    assert not held.any() and np.isfinite(forces).all()
    assert np.abs(forces).max() <= model.certify().force_bound_N


@pytest.mark.parametrize("which", [*FITTED, *BODIES, *range(60)])
def test_python_and_numba_give_the_same_bits(which: str | int) -> None:
    model = model_of(which)
    if isinstance(which, int) and which % 2:
        model = replace(model, force_envelope_N=(-500.0, 500.0))
    arrays = model.body.lay_out(model.operating_range).arrays()
    p, n, s, k = (list(part) for part in arrays)
    numbers = [np.array(part, float) for part in (p, s)]
    wholes = [np.array(part, np.int64) for part in (n, k)]
    same = numbers[0], wholes[0], numbers[1], wholes[1]
    reset, tick = compile_tick(hydraulic_reset), compile_tick(hydraulic_tick)
    hydraulic_reset(p, n, s, k)
    reset(*same)
    rows = [*hostile_inputs(model, Random(7), COMPARED), (0.0, 0.1, np.nan), (0.0, np.inf, 0.5), (np.nan, 0.0, 0.5)]
    for row in rows:
        assert hydraulic_tick(p, n, s, k, *row).hex() == float(tick(*same, *row)).hex()
        np.testing.assert_array_equal(s, same[2])
        np.testing.assert_array_equal(k, same[3])
