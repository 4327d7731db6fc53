"""Levenberg-Marquardt, with and without penalties, on problems whose solutions are known."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from ces_identify.numerics.least_squares import (
    CENTRED,
    FREE,
    NO_MODEL,
    NormalEquations,
    check_error_first,
    damped_step,
    descend,
    evaluate,
    improve,
    limit_gains,
    pull_towards,
)


def equations_of(residuals, jacobian):
    """Normal equations of residuals (measured minus simulated) and their derivatives."""

    def differentiate(params):
        r, j = residuals(params), jacobian(params)
        return NormalEquations(float(r @ r), j.T @ j, -j.T @ r)

    return check_error_first(lambda params: float(residuals(params) @ residuals(params)), differentiate)


VALLEY = equations_of(  # Rosenbrock's, whose only minimum is (1, 1)
    lambda t: np.array([1.0 - t[0], 10.0 * (t[1] - t[0] ** 2)]), lambda t: np.array([[-1.0, 0.0], [-20.0 * t[0], 10.0]])
)


@pytest.mark.parametrize("damping", [FREE, CENTRED], ids=["free", "short steps"])
def test_it_follows_a_bent_valley_to_its_bottom_and_never_climbs(damping):
    points = list(islice(descend(VALLEY, np.array([-1.2, 1.0]), damping=damping), 200))
    values = [point.value for point in points]
    assert values == sorted(values, reverse=True)
    assert np.abs(np.diff([point.params for point in points], axis=0)).max() <= damping.max_move * (1.0 + 1e-12)
    np.testing.assert_allclose(points[-1].params, [1.0, 1.0], atol=1e-5)


def test_it_ends_where_no_step_helps_or_after_some_tries():
    def flat(params, most):
        return NormalEquations(1.0, np.eye(2), np.zeros(2))

    assert 2 < len(list(descend(flat, np.zeros(2)))) < 40
    assert len(list(descend(flat, np.zeros(2), damping=replace(FREE, tries=3)))) == 1 + 3


def test_undamped_step_is_least_squares_whatever_the_scales():
    random = np.random.default_rng(0)
    columns = random.normal(size=(50, 3)) * [1e-4, 1.0, 1e5]
    target = random.normal(size=50)
    expected = np.linalg.lstsq(columns, target, rcond=None)[0]
    np.testing.assert_allclose(damped_step(columns.T @ columns, columns.T @ target, 0.0), expected, rtol=1e-6)


def test_a_parameter_without_effect_stays():
    step = damped_step(np.diag([2.0, 0.0]), np.array([4.0, 0.0]), 0.0)
    assert step == pytest.approx([2.0, 0.0])


def test_the_pull_leads_to_its_centre_as_ridge_regression_does():
    random = np.random.default_rng(2)
    matrix, right, centre = random.standard_normal((20, 3)), random.standard_normal(20), 0.7
    linear = equations_of(lambda t: right - matrix @ t, lambda t: -matrix)
    *_, last = improve(linear, np.zeros(3), [pull_towards(np.full(3, centre), np.full(3, 5.0))])
    wanted = np.linalg.solve(matrix.T @ matrix + 5.0 * np.eye(3), matrix.T @ right + 5.0 * centre)
    np.testing.assert_allclose(last.params, wanted, atol=1e-6)
    assert last.data.error == pytest.approx(float(((matrix @ wanted - right) ** 2).sum()))
    assert last.value == pytest.approx(last.data.error + 5.0 * float(((wanted - centre) ** 2).sum()))


def test_a_limit_of_gains_costs_what_is_beyond_it_and_leads_back():
    penalty = limit_gains(lambda params: 2.0 * params, lambda params, above: 2.0 * np.eye(3)[above], 1.0, 10.0)
    beyond = penalty(np.array([0.5, 0.7, -9.0]))
    assert beyond.error == pytest.approx(10.0 * 0.4**2)
    np.testing.assert_allclose(beyond.matrix, np.diag([0.0, 40.0, 0.0]))
    np.testing.assert_allclose(beyond.gradient, [0.0, -8.0, 0.0])


def test_a_start_that_is_no_model_gives_no_point():
    broken = equations_of(lambda t: np.array([np.nan]), lambda t: np.ones((1, 1)))
    for equations in (broken, lambda params, most: NO_MODEL):
        assert list(descend(equations, np.zeros(1))) == []
        assert evaluate(equations, [], np.zeros(1)) is None
