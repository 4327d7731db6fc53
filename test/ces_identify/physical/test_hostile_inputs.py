"""Hostile inputs: every force of a hydraulic network is finite, within its proved bound, and as on the vehicle.

Inputs jump between the ends of the reach and beyond, alternate, stand still and swing (`hostile_inputs`). All of them
go through the batch run, in which a step that does not converge gives no number. The first of each model also go
through the tick, which must give the same forces.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hydraulic_models import hydraulic_model, random_hydraulic
from physical_models import FITTED, fitted_model, hostile_inputs
from samplings import make_sampling

from ces_identify.structures import run_batch
from ces_observer.model import Model, parse_model

pytestmark = pytest.mark.slow

TICKS, COMPARED = 20_000, 1_000


def model_of(which: str | int) -> Model:
    """Return a fitted model, or a random one as read from its file, without a force envelope that matters."""
    if isinstance(which, str):
        model = fitted_model(which)
    else:
        random = Random(1000 + which)
        model = hydraulic_model(random_hydraulic(random), make_sampling(random.choice((200.0, 1000.0, 4000.0))))
    return replace(parse_model(model.to_json(), "m.json"), force_envelope_N=(-1e300, 1e300))


@pytest.mark.parametrize("which", [*FITTED, *range(8)])
def test_forces_are_finite_within_the_bound_and_the_same_as_on_the_vehicle(which: str | int) -> None:
    model = model_of(which)
    bound = model.certify().force_bound_N
    inputs = np.array(list(hostile_inputs(model, Random(7), TICKS))).T
    forces, held = run_batch(model, inputs, np.array([[0, TICKS]]))
    assert not held.any() and np.isfinite(forces).all()
    assert np.abs(forces).max() <= bound
    run = model.make_predictor()
    ticks = np.array([run.tick(*row) for row in inputs[:, :COMPARED].T.tolist()])
    assert np.abs(ticks - forces[:COMPARED]).max() <= 1e-9 * max(1.0, np.abs(forces).max())
