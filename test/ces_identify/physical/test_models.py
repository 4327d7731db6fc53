"""Parameters, bounds and derivatives of models with physics inside, and models opened again from their file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from physical_models import CHAMBERS, RELAXATION
from planted import SAMPLING
from planted_dampers import KINDS, models_of, planted_model, ride, true_parameters

from ces_identify.physical.layout import Layout, group
from ces_identify.simulations.simulate import simulate_series
from ces_observer.model import Model, parse_model


def test_projection_moves_into_the_bounds_and_under_the_sum():
    layout = Layout((group("share", [0.2, 0.2], 0.1, 1.0, max_sum=0.5), group("mass", 1.0, 0.0, 2.0)))
    assert layout.project(np.array([0.05, 0.3, 9.0])).tolist() == [0.1, 0.3, 2.0]
    shrunk = layout.project(np.array([0.8, 0.8, -1.0]))
    assert shrunk[:2].sum() == pytest.approx(0.5)
    assert shrunk[2] == 0.0


def test_an_entry_of_the_penalty_is_never_too_small():
    """A rise that starts at next to nothing may still change as the others of its curve do."""
    assert group("rises", [1.0, 1e-9]).scale.tolist() == pytest.approx([1.0, 0.15])


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_vector_within_the_bounds_is_a_model_that_its_file_can_hold(kind):
    models, random = models_of(kind), np.random.default_rng(4)
    for _ in range(10):
        theta = models.layout.project(true_parameters(kind) * np.exp(random.normal(0.0, 3.0, len(models.layout.start))))
        model = Model(SAMPLING, models.body(theta), models.training.envelope, (-1e9, 1e9))
        assert model.certify().holds
        assert parse_model(model.to_json(), "m.json").body == model.body
        assert json.loads(model.to_json())["structure"] == kind


@pytest.mark.parametrize("kind", KINDS)
def test_its_parameters_and_force_are_those_of_the_file(kind):
    models, model = models_of(kind), planted_model(kind)
    opened, theta = type(models).reopen(model.body, models.scales.interval_s, models.training)
    np.testing.assert_allclose(theta, true_parameters(kind), rtol=1e-6, atol=1e-9)
    series = ride(1)
    force = simulate_series(model, series).force
    np.testing.assert_allclose(opened.force(theta)[series.scored], force[series.scored], atol=1e-6)


@pytest.mark.parametrize("body", [CHAMBERS, RELAXATION], ids=["chambers", "relaxation"])
def test_a_model_made_by_hand_is_refused(body):
    kind = "chambers" if body is CHAMBERS else "relaxation"
    models = models_of(kind)
    assert type(models).reopen(body, models.scales.interval_s, models.training) is None


STEP = 1e-5


def noisy(kind):
    """Errors of all signs and a slope: a gradient that is not zero anywhere."""
    models = models_of(kind)
    force = models.force(true_parameters(kind))
    wanted = 0.9 * force + np.random.default_rng(0).normal(20.0, 50.0, len(force))
    return replace(models, training=replace(models.training, measured=wanted))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_gradients_are_those_of_finite_differences(kind) -> None:
    models, theta = noisy(kind), true_parameters(kind)
    weights, layout = models.training.estimation, models.layout
    gradient = models.normal_equations(theta, weights)[2] * layout.scale
    first = 0
    for one in layout.groups:
        places = range(first, first + len(one.start))
        first = places.stop
        largest = np.abs(gradient[places]).max()
        assert largest > 0.0, one.name
        for p in places:
            step = STEP * layout.scale * (np.arange(len(theta)) == p)
            slope = (models.error(theta + step, weights) - models.error(theta - step, weights)) / (4 * STEP)
            assert gradient[p] == pytest.approx(slope, rel=2e-3, abs=2e-3 * largest + 1e-10), one.name


@pytest.mark.parametrize("kind", KINDS)
def test_the_matrix_is_that_of_the_derivatives(kind):
    """The change of the force along a direction, squared and weighted, is the matrix in that direction."""
    models, theta = noisy(kind), true_parameters(kind)
    weights, layout = models.training.estimation, models.layout
    _, matrix, _ = models.normal_equations(theta, weights)
    random = np.random.default_rng(2)
    for _ in range(3):
        direction = layout.scale * random.standard_normal(len(theta))
        change = (models.force(theta + 1e-6 * direction) - models.force(theta - 1e-6 * direction)) / 2e-6
        assert direction @ matrix @ direction == pytest.approx(weights @ change**2, rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_gradients_of_blocks_add_up(kind):
    models, theta = noisy(kind), true_parameters(kind)
    weights = models.training.estimation
    blocks = np.arange(len(weights)) // 100
    _, _, gradients = models.sensitivities(theta, weights, blocks)
    _, _, gradient = models.normal_equations(theta, weights)
    assert gradients.shape == (blocks.max() + 1, len(theta))
    np.testing.assert_allclose(gradients.sum(axis=0), gradient, rtol=1e-9, atol=1e-12 * np.abs(gradient).max())
