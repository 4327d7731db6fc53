"""Levenberg-Marquardt, free and about a centre, on problems whose solutions are known."""

from itertools import islice

import numpy as np
import pytest

from ces_identify.numerics.least_squares import CENTRED, CentredProblem, damped_step, descend, descend_about_centre


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


def problem(residuals, jacobian, size, weights=0.0, centre=0.0):
    def normal_equations(theta):
        r, j = residuals(theta), jacobian(theta)
        return float(r @ r), j.T @ j, j.T @ r

    return CentredProblem(
        lambda theta: float(residuals(theta) @ residuals(theta)),
        normal_equations,
        np.full(size, weights),
        np.full(size, centre),
    )


def test_a_curved_valley_is_followed_to_its_end_in_short_steps():
    bent = problem(
        lambda t: np.array([1.0 - t[0], 10.0 * (t[1] - t[0] ** 2)]),
        lambda t: np.array([[-1.0, 0.0], [-20.0 * t[0], 10.0]]),
        2,
    )
    start = np.array([-1.2, 1.0])
    steps = list(descend_about_centre(bent, start))
    values, path = [value for value, _ in steps], np.array([start, *(theta for _, theta in steps)])
    assert values == sorted(values, reverse=True)
    assert np.abs(np.diff(path, axis=0)).max() <= CENTRED.max_move * (1.0 + 1e-12)
    np.testing.assert_allclose(path[-1], (1.0, 1.0), atol=1e-5)


def test_the_penalty_pulls_to_its_centre_as_ridge_regression_does():
    random = np.random.default_rng(2)
    matrix, right, centre = random.standard_normal((20, 3)), random.standard_normal(20), 0.7
    ridge = problem(lambda t: matrix @ t - right, lambda t: matrix, 3, weights=5.0, centre=centre)
    wanted = np.linalg.solve(matrix.T @ matrix + 5.0 * np.eye(3), matrix.T @ right + 5.0 * centre)
    *_, (value, theta) = descend_about_centre(ridge, np.zeros(3))
    np.testing.assert_allclose(theta, wanted, atol=1e-6)
    assert value == pytest.approx(float(((matrix @ wanted - right) ** 2).sum()) + ridge.penalty(wanted))


def test_a_start_that_is_not_finite_or_diverges_gives_no_step():
    assert list(descend(lambda params, most: (np.inf, np.eye(1), np.zeros(1)), np.zeros(1))) == []
    broken = problem(lambda t: np.array([np.nan]), lambda t: np.ones((1, 1)), 1)
    assert list(descend_about_centre(broken, np.zeros(1))) == []
