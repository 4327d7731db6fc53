"""Bounded Levenberg-Marquardt on problems whose solutions are known."""

import numpy as np
import pytest
from scipy.optimize import nnls

from ces_identify.numerics.levenberg import BoundedProblem, descend_within_bounds


def problem(residuals, jacobian, low, high, weights=0.0, centre=0.0):
    size = len(low)

    def normal_equations(theta):
        r, j = residuals(theta), jacobian(theta)
        return float(r @ r), j.T @ j, j.T @ r

    return BoundedProblem(
        lambda theta: float(residuals(theta) @ residuals(theta)),
        normal_equations,
        lambda theta: np.clip(theta, low, high),
        low,
        high,
        np.full(size, weights),
        np.full(size, centre),
    )


def last(one, start):
    *_, (value, theta) = descend_within_bounds(one, start)
    return value, theta


def test_a_linear_problem_with_bounds_has_the_solution_of_nnls():
    random = np.random.default_rng(1)
    matrix, right = random.standard_normal((30, 6)), random.standard_normal(30)
    wanted, norm = nnls(matrix, right)
    assert (wanted == 0.0).any() and (wanted > 0.0).any()
    bounded = problem(lambda t: matrix @ t - right, lambda t: matrix, np.zeros(6), np.full(6, np.inf))
    value, theta = last(bounded, np.ones(6))
    np.testing.assert_allclose(theta, wanted, atol=1e-6)
    assert value == pytest.approx(norm**2)


@pytest.mark.parametrize(("highest", "wanted"), [(2.0, (1.0, 1.0)), (0.5, (0.5, 0.25))])
def test_a_curved_valley_is_followed_to_its_end_or_to_the_bound(highest, wanted):
    """Rosenbrock's function; with x <= 0.5 the least value is at x = 0.5, y = x^2."""
    valley = problem(
        lambda t: np.array([1.0 - t[0], 10.0 * (t[1] - t[0] ** 2)]),
        lambda t: np.array([[-1.0, 0.0], [-20.0 * t[0], 10.0]]),
        np.array([-2.0, -2.0]),
        np.array([highest, 2.0]),
    )
    _, theta = last(valley, np.array([-1.2, 1.0]))
    np.testing.assert_allclose(theta, wanted, atol=1e-5)


def test_the_penalty_pulls_to_its_centre_as_ridge_regression_does():
    random = np.random.default_rng(2)
    matrix, right, centre = random.standard_normal((20, 3)), random.standard_normal(20), 0.7
    free = np.full(3, -np.inf), np.full(3, np.inf)
    ridge = problem(lambda t: matrix @ t - right, lambda t: matrix, *free, weights=5.0, centre=centre)
    wanted = np.linalg.solve(matrix.T @ matrix + 5.0 * np.eye(3), matrix.T @ right + 5.0 * centre)
    value, theta = last(ridge, np.zeros(3))
    np.testing.assert_allclose(theta, wanted, atol=1e-6)
    assert value == pytest.approx(float(((matrix @ wanted - right) ** 2).sum()) + ridge.penalty(wanted))


def test_each_step_lowers_the_value():
    cubic = problem(lambda t: t**3 - 8.0, lambda t: np.diag(3.0 * t**2), np.zeros(2), np.full(2, 10.0))
    values = [value for value, _ in descend_within_bounds(cubic, np.array([9.0, 0.5]))]
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(0.0, abs=1e-12)


def test_a_start_that_is_not_finite_gives_no_step():
    broken = problem(lambda t: np.array([np.nan]), lambda t: np.ones((1, 1)), np.zeros(1), np.ones(1))
    assert list(descend_within_bounds(broken, np.zeros(1))) == []
