from itertools import islice

import numpy as np
import pytest

from ces_identify.numerics.levenberg import damped_step, descend


def valley(params, most):
    """Rosenbrock's valley as residuals (1 - x, 10 (y - x^2)); its only minimum is (1, 1)."""
    x, y = params
    residual = np.array([1.0 - x, 10.0 * (y - x * x)])
    jacobian = -np.array([[-1.0, 0.0], [-20.0 * x, 10.0]])
    error = float(residual @ residual)
    return (error if error <= most else np.inf), jacobian.T @ jacobian, jacobian.T @ residual


def test_it_finds_the_bottom_of_a_bent_valley_and_never_climbs():
    steps = list(islice(descend(valley, np.array([-1.2, 1.0])), 60))
    errors = [error for error, _ in steps]
    assert errors == sorted(errors, reverse=True)
    np.testing.assert_allclose(steps[-1][1], [1.0, 1.0], atol=1e-8)


def test_a_start_that_diverges_yields_nothing():
    assert list(descend(lambda params, most: (np.inf, np.eye(1), np.zeros(1)), np.zeros(1))) == []


def test_it_ends_where_no_step_helps():
    def flat(params, most):
        return 1.0, np.eye(2), np.zeros(2)

    assert 2 < len(list(descend(flat, np.zeros(2)))) < 40


def test_undamped_step_is_least_squares_whatever_the_scales():
    random = np.random.default_rng(0)
    columns = random.normal(size=(50, 3)) * [1e-4, 1.0, 1e5]
    target = random.normal(size=50)
    expected = np.linalg.lstsq(columns, target, rcond=None)[0]
    np.testing.assert_allclose(damped_step(columns.T @ columns, columns.T @ target, 0.0), expected, rtol=1e-6)


def test_a_parameter_without_effect_stays():
    step = damped_step(np.diag([2.0, 0.0]), np.array([4.0, 0.0]), 0.0)
    assert step == pytest.approx([2.0, 0.0])
