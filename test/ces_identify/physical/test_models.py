"""Parameters and derivatives of hydraulic networks."""

import json
from dataclasses import replace

import numpy as np
import pytest
from planted import SAMPLING
from planted_dampers import KINDS, planted_model, ride, started, truth

from ces_identify.physical.models import free_run
from ces_identify.simulations.simulate import simulate_series
from ces_observer.errors import ModelError
from ces_observer.model import Model, parse_model
from ces_observer.records import read_record, write_record
from ces_observer.structures.hydraulic import Hydraulic

SHORT_S = 4.0
STEP = 1e-6  # few steps move a drop across zero, where the opening of a check jumps
LAYOUTS = [(kind, how) for kind in KINDS for how in ("laws", "nodes", "bypass")]


def case(kind, how):
    """Models and parameters; the measured forces have errors of all signs, so that no gradient is zero."""
    if how == "laws":
        models = started(kind, seconds=SHORT_S)
        theta = models.layout.centre + 0.2 * np.random.default_rng(1).standard_normal(len(models.layout.centre))
    else:
        models, theta = truth(kind, how == "bypass", SHORT_S)
    force = models.force(theta)
    wanted = 0.9 * force + np.random.default_rng(0).normal(20.0, 50.0, len(force))
    return replace(models, training=replace(models.training, measured=wanted)), theta


@pytest.mark.parametrize("kind", KINDS)
def test_every_vector_is_a_model_that_its_file_can_hold(kind):
    (models, theta), random = truth(kind, bypass=True), np.random.default_rng(4)
    for spread in (0.0, 1.0, 3.0):
        body = models.body(theta + spread * random.standard_normal(len(theta)))
        model = Model(SAMPLING, body, models.training.envelope, (-1e9, 1e9))
        assert model.certify().holds
        assert parse_model(model.to_json(), "m.json").body == model.body
        assert json.loads(model.to_json())["structure"] == "hydraulic"


@pytest.mark.parametrize("end", [-80.0, 80.0])
@pytest.mark.parametrize("kind", KINDS)
def test_the_ends_of_every_parameter_can_be_written_and_read_with_the_same_force(kind, end):
    """A diagnosis wrote a chamber of 4.7e-15 m/N, which no program read."""
    models, theta = truth(kind, bypass=True)
    owners, inputs = np.array(models.layout.owners), models.training.inputs[:, :200]
    for name in dict.fromkeys(owners):
        places = np.flatnonzero(owners == name)
        for moved in (places, places[:1]):
            body = models.body(theta + end * np.isin(np.arange(len(theta)), moved))
            again = read_record(Hydraulic, write_record(body), name, ModelError, complete=True)
            forces = [free_run(one, models.scales.interval_s, inputs, np.array([[0, 200]])) for one in (body, again)]
            np.testing.assert_array_equal(*forces, err_msg=name)


@pytest.mark.parametrize("bypass", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_its_parameters_and_force_are_those_of_the_file(kind, bypass):
    (models, theta), model, series = truth(kind, bypass), planted_model(kind, bypass), ride(1)
    force = simulate_series(model, series).force
    np.testing.assert_allclose(models.force(theta)[series.scored], force[series.scored], rtol=1e-12, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "how"), LAYOUTS)
def test_gradients_are_those_of_finite_differences(kind, how) -> None:
    models, theta = case(kind, how)
    weights, owners = models.training.estimation, np.array(models.layout.owners)
    gradient = models.normal_equations(theta, weights)[2]
    for name in dict.fromkeys(owners):
        places = np.flatnonzero(owners == name)
        largest = np.abs(gradient[places]).max()
        assert largest > 0.0, name
        for p in places[:: 1 + len(places) // 9]:
            step = STEP * (np.arange(len(theta)) == p)
            slope = (models.error(theta - step, weights) - models.error(theta + step, weights)) / (4 * STEP)
            assert gradient[p] == pytest.approx(slope, rel=2e-3, abs=2e-3 * largest + 1e-10), name


@pytest.mark.parametrize(("kind", "how"), LAYOUTS)
def test_the_matrix_is_that_of_the_derivatives(kind, how):
    """The change of the force along a direction, squared and weighted, is the matrix in that direction."""
    models, theta = case(kind, how)
    weights = models.training.estimation
    _, matrix, _ = models.normal_equations(theta, weights)
    direction = np.random.default_rng(2).standard_normal(len(theta))
    change = (models.force(theta + 1e-6 * direction) - models.force(theta - 1e-6 * direction)) / 2e-6
    assert direction @ matrix @ direction == pytest.approx(weights @ change**2, rel=2e-3)
