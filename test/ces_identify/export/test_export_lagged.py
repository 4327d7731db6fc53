"""Exported sigmoid networks and neuro-fuzzy models are the estimator's twins."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from exported_c import (
    INPUTS,
    c_steps,
    c_ticks,
    compile_c,
    python_steps,
    python_ticks,
    seeded,
    undefined_and_defined,
)
from trained_models import FUZZY, NETWORK, fuzzy_model, network_model

from ces_observer.structures.fuzzy import Bell, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor

ONE_INPUT = (Regressor("speed", 64, -0.1, 0.3),)
MODELS = {
    "network": network_model(),
    "network without units": network_model(replace(NETWORK, units=())),
    "network of one input": network_model(
        replace(NETWORK, regressors=ONE_INPUT, linear=(0.7,), units=(replace(NETWORK.units[0], slopes=(900.0,)),))
    ),
    "rules": fuzzy_model(),
    "one rule": fuzzy_model(
        replace(
            FUZZY,
            regressors=ONE_INPUT,
            premises=(Premise("position", 7, (Bell(-0.01, 2.0, 0.5),)),),
            rules=(Rule((0,), 0.2, (0.5,)),),
        )
    ),
    "unstable rules": fuzzy_model(replace(FUZZY, rules=(Rule((0, 0), 0.1, (1.3, 0.0, 0.2, 0.0, 0.0)),))),
}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Return the compiled library of a model of MODELS, by its name."""
    return cache(lambda name: compile_c(tmp_path_factory.mktemp("model"), MODELS[name]))


@pytest.mark.needs("cc")
@pytest.mark.parametrize("shape", INPUTS)
@pytest.mark.parametrize("name", MODELS)
def test_forces_and_reasons_are_the_estimators(library, name, shape):
    samples = seeded(shape)
    rows, reasons = c_steps(library(name), *samples)
    expected, expected_reasons = python_steps(MODELS[name], *samples)
    np.testing.assert_array_equal(reasons, expected_reasons)
    np.testing.assert_allclose(rows, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.needs("cc")
def test_the_twins_are_compared_on_forces_and_on_an_unbounded_run(library):
    moving = c_steps(library("rules"), *seeded(INPUTS[0]))[0][:, 0]
    assert np.nanmax(np.abs(moving)) > 20.0
    assert math.isnan(c_steps(library("unstable rules"), *seeded(INPUTS[0]))[0][-1, 0])


@pytest.mark.needs("cc")
@pytest.mark.parametrize("name", MODELS)
def test_a_tick_is_the_structures(library, name):
    dice = np.random.default_rng(7)
    inputs = [dice.normal(0, spread, 1000) + mean for mean, spread in ((0, 0.01), (0, 0.8), (0.5, 0.3))]
    inputs[1][25::50] = np.nan
    forces, expected = c_ticks(library(name), *inputs), python_ticks(MODELS[name], *inputs)
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(forces, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.needs("cc", "nm")
@pytest.mark.parametrize("name", ["network", "rules"])
def test_it_needs_nothing_but_math_and_has_no_globals(tmp_path, name):
    compile_c(tmp_path, MODELS[name])
    needed, kinds = undefined_and_defined(tmp_path)
    assert needed <= {"cos", "exp", "floor", "fmin", "pow"}
    assert not {n for n, kind in kinds.items() if kind in "bBdDC"}
