"""The intervals of a report hold the planted values about as often as they say."""

from functools import cache

import numpy as np
import pytest
from planted_dampers import KINDS, models_of, planted_models, true_parameters

from ces_identify.physical.physical_search import PENALTIES, PhysicalSearch
from ces_identify.physical.quantities import (
    ParameterErrors,
    describe_errors,
    parameter_errors,
    read_quantities,
    steady_force_map,
)
from ces_identify.polynomial.search_limits import Limits

DRAWS = 2
PENALTY = PENALTIES[-1]


def fitted(kind, seed):
    """A fit from the true parameters: intervals say nothing of other optima."""
    models = planted_models(kind, seed)
    search = PhysicalSearch(Limits(time=60.0, threads=1), lambda result: None)
    return models, search.refit(search._fit(models, true_parameters(kind), PENALTY, 0))


def values_of(models, theta, errors):
    body, interval = models.body(theta), models.scales.interval_s
    stroke = models.training.envelope.position_m
    quantities = read_quantities(type(models), body, interval, stroke)
    forces = steady_force_map(
        type(models), body, interval, stroke, np.array(errors["speed_m_s"]), np.array(errors["current_A"])
    )
    return np.array(list(quantities.values())), forces


@cache
def scores(kind):
    """Errors in standard errors, of the quantities and of the steady forces at recorded speeds, for every draw."""
    both = []
    for seed in range(DRAWS):
        models, theta = fitted(kind, seed)
        errors = describe_errors(models, theta, PENALTY)
        estimated, true = (values_of(models, at, errors) for at in (theta, true_parameters(kind)))
        speeds = np.array(errors["speed_m_s"])
        recorded = np.array([(speeds >= low) & (speeds <= high) for low, high in errors["recorded_m_s"]])
        sizes = np.array(list(errors["quantities"].values()))
        known = sizes > 0.0
        forces = (estimated[1] - true[1]) / np.array(errors["steady_force_N"])
        both.append([((estimated[0] - true[0])[known] / sizes[known]), forces[recorded]])
    return [np.concatenate(parts) for parts in zip(*both, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1], ids=["quantities", "steady forces"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_95_percent_intervals_hold_the_planted_values(kind, which):
    z = scores(kind)[which]
    assert len(z) > 25
    assert 0.88 <= np.mean(np.abs(z) < 1.96) <= 1.0
    assert 0.3 < np.sqrt(np.median(z**2)) / 0.6745 < 1.5


def test_what_the_data_leave_open_is_as_uncertain_as_its_scale():
    models = planted_models("chambers", 1)
    theta = true_parameters("chambers").copy()
    layout = models.layout
    errors = parameter_errors(models, theta, 1.0)
    sizes = np.sqrt((errors.root**2).sum(axis=1)) / layout.scale
    assert sizes.max() < 1.5
    assert sizes.max() > 0.8  # the last nodes of the curves, beyond all speeds recorded


def test_parameters_at_a_bound_have_no_error():
    models, theta = planted_models("relaxation", 1), true_parameters("relaxation").copy()
    theta[0] = models.layout.low[0]
    errors = parameter_errors(models, theta, PENALTY)
    assert (errors.root[0] == 0.0).all()
    assert (errors.root[1] != 0.0).any()


def test_the_delta_method_is_exact_for_linear_values():
    root = np.array([[1.0, 0.0], [0.5, 2.0]])
    errors = ParameterErrors(np.array([1.0, 2.0]), np.array([0.0, 0.0]), np.array([9.0, 2.0]), root)
    weights = np.array([[1.0, 1.0], [0.0, 3.0]])
    expected = np.sqrt(((weights @ root) ** 2).sum(axis=1))
    np.testing.assert_allclose(errors.of(lambda theta: weights @ theta), expected, rtol=1e-9)


def test_too_little_data_gives_no_errors():
    models = models_of("chambers")
    few = models.training.segments.copy()
    few[-1, 1] = few[-1, 0] + 300
    short = type(models)(models.training.__class__(**{**vars(models.training), "segments": few}), models.scales)
    assert parameter_errors(short, true_parameters("chambers"), PENALTY) is None
    assert describe_errors(short, true_parameters("chambers"), PENALTY) == {}
