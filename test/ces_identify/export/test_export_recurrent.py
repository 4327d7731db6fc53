"""Exported recurrent networks do what they do in Python, alone and beside another model, on hostile input, too."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bands import BAND
from exported_c import (
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
from recurrent_models import make_recurrent, recurrent_model
from trained_models import network_model

from ces_identify.export.export_c import export_c

needs_cc = pytest.mark.needs("cc")
SPEED_ONLY = replace(
    make_recurrent(3, 1, current=False), motion=tuple(replace(one, mean=0.0) for one in make_recurrent().motion)
)
MODELS = {
    "mean of two": recurrent_model,
    "no current": lambda: recurrent_model(make_recurrent(2, 3, current=False), band=BAND),
    "one network": lambda: recurrent_model(SPEED_ONLY),
    "a delay": lambda: with_delay(recurrent_model(band=BAND), 0.005),
    "beside a sigmoid network": lambda: two_models(recurrent_model(), network_model(), 0.003),
    "two of them": lambda: two_models(recurrent_model(), recurrent_model(make_recurrent(5, 1, current=False)), 0.002),
}


@needs_cc
@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_forces_and_reasons_are_the_estimators(tmp_path, name) -> None:
    model = MODELS[name]()
    library = compile_c(tmp_path, model)
    for shape in (INPUTS[0], INPUTS[-1]):
        samples = seeded(shape)
        assert_same(c_steps(library, *samples), python_steps(model, *samples), 1e-9, shape.__name__)


@needs_cc
@pytest.mark.parametrize("name", ["mean of two", "no current", "one network"])
def test_ticks_are_those_of_python_and_stay_within_the_proved_bound(tmp_path, name) -> None:
    model = replace(MODELS[name](), force_envelope_N=(-1e9, 1e9))
    library, inputs = compile_c(tmp_path, model), hostile(3000, 1)
    inputs[1][1000] = inputs[0][2000] = math.nan
    np.testing.assert_allclose(c_ticks(library, *inputs), python_ticks(model, *inputs), rtol=1e-9, atol=1e-9)
    forces = c_ticks(library, *hostile(200_000, 4))
    assert np.abs(forces).max() <= model.certify().force_N


@needs_cc
def test_a_force_beyond_its_envelope_is_held(tmp_path) -> None:
    model, inputs = recurrent_model(force_envelope_N=(-100.0, 150.0)), hostile(1000, 5)
    forces = c_ticks(compile_c(tmp_path, model), *inputs)
    assert (forces.min(), forces.max()) == model.force_envelope_N
    np.testing.assert_allclose(forces, python_ticks(model, *inputs), rtol=1e-9, atol=1e-9)


def test_comments_state_the_proof() -> None:
    model = recurrent_model()
    source, header = export_c(model, "model", "model", model.certify())
    assert "recurrent network" in source
    assert "dies out" in header
    assert f"never exceeds {model.certify().force_N} N" in header
