"""The compiled derivatives of both kernels against finite differences, one group of parameters at a time."""

from dataclasses import replace

import numpy as np
import pytest
from planted_dampers import KINDS, models_of, true_parameters

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
