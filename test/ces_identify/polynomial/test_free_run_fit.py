"""Simulation-error fitting: its kernels against finite differences, its steps downhill and inside the stable models."""

import numpy as np
import pytest
from kernel_examples import SEGMENTS, TERMS, make_inputs, tables  # noqa: F401 - make_inputs is a fixture

from ces_identify.numerics import kernels
from ces_identify.polynomial.free_run_fit import (
    candidate_products,
    fit_free_run,
    normal_equations,
    output_gains,
    sensitivities,
)
from ces_identify.polynomial.problem import assemble_problem
from ces_identify.polynomial.rules_file import parse_rules
from ces_identify.prepare.series import prepare


def run(powers, layout, coefficients):
    return kernels.free_run(powers, SEGMENTS, layout.arrays, coefficients, (-1e9, 1e9))[0]


def slopes(powers, layout, coefficients):
    """Return dy/dc (ticks, terms) by central differences."""
    columns = []
    for t in range(len(coefficients)):
        step = np.zeros(len(coefficients))
        step[t] = 1e-6
        plus, minus = run(powers, layout, coefficients + step), run(powers, layout, coefficients - step)
        columns.append((plus - minus) / 2e-6)
    return np.array(columns).T


@pytest.fixture
def case(inputs):
    layout, powers, coefficients = tables(TERMS, inputs)
    force = run(powers, layout, coefficients)
    measured = force + np.random.default_rng(3).normal(size=len(force))
    weights = np.where(np.arange(len(force)) % 5 == 0, 0.01, 0.0)
    return layout, powers, coefficients, force, measured, weights


def test_normal_equations_are_those_of_the_sensitivities(case):
    layout, powers, coefficients, force, measured, weights = case
    error, matrix, gradient = normal_equations(
        powers, SEGMENTS, weights, measured, layout.arrays, coefficients, (-1e9, 1e9)
    )
    s = slopes(powers, layout, coefficients)
    assert error == pytest.approx((weights * (measured - force) ** 2).sum(), rel=1e-9)
    np.testing.assert_allclose(matrix, s.T @ (weights[:, None] * s), rtol=1e-5)
    np.testing.assert_allclose(gradient, s.T @ (weights * (measured - force)), rtol=1e-5, atol=1e-5)


def test_a_run_out_of_bounds_has_an_infinite_error(case):
    layout, powers, coefficients, _, measured, weights = case
    args = (powers, SEGMENTS, weights, measured, layout.arrays, coefficients)
    assert normal_equations(*args, (-1e-3, 1e-3))[0] == np.inf


def test_a_candidate_outside_the_model_has_its_sensitivity_at_zero(case):
    """The last terms are left out of the model; their sensitivities are those at a coefficient of zero."""
    layout, powers, coefficients, *_, measured, weights = case
    inside, outside = np.arange(4), np.array([4, 5])
    zero = np.where(np.arange(6) < 4, coefficients, 0.0)
    own = layout.subset(inside)
    lags = np.unique(own.outputs[own.outputs > 0])
    gains = output_gains(powers, SEGMENTS, own, coefficients[:4], lags)
    force = run(powers, layout, zero)
    expected = slopes(powers, layout, zero)
    c = layout
    every = np.ones(len(force))
    both = sensitivities(powers, SEGMENTS, force, c.arrays, outside, gains, lags, every)
    np.testing.assert_allclose(both, expected[:, 4:], rtol=1e-5, atol=1e-6)
    error = measured - force
    matrix, gradient, cross, itself = candidate_products(
        powers, SEGMENTS, force, c.arrays, inside, outside, gains, lags, weights, error
    )
    w = weights[:, None] * expected
    np.testing.assert_allclose(matrix, expected[:, :4].T @ w[:, :4], rtol=1e-5)
    np.testing.assert_allclose(gradient, w[:, :4].T @ error, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(cross, w[:, 4:].T @ expected[:, :4], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(itself[:, 0], (w[:, 4:] * expected[:, 4:]).sum(axis=0), rtol=1e-5)
    np.testing.assert_allclose(itself[:, 1], w[:, 4:].T @ error, rtol=1e-4, atol=1e-4)


@pytest.fixture(scope="module")
def problem():
    from identification_examples import RULES, SAMPLING, planted

    return assemble_problem([prepare(planted(1), SAMPLING)], RULES.candidates())


def test_a_fit_finds_the_planted_coefficients_from_afar(problem):
    from identification_examples import PLANTED

    factors = [c.factors for c in problem.candidates]
    chosen = np.array([factors.index(t.factors) for t in PLANTED.body.terms])
    planted = np.array([t.coefficient for t in PLANTED.body.terms])
    fit = fit_free_run(problem, chosen, planted * [0.5, 1.6, 0.7], problem.everything, 30)
    np.testing.assert_allclose(fit.coefficients, planted, rtol=0.02)


def test_a_fit_stays_inside_the_stable_models():
    """The plant is an integrator but for a trace: least squares alone would not be a contraction."""
    from dataclasses import replace

    from identification_examples import SAMPLING, planted

    from ces_data.recording import Channel

    recording = planted(1, seconds=20.0)
    speed = prepare(recording, SAMPLING).speed
    force = recording.channel("force")
    sums = np.convolve(speed, 0.9999 ** np.arange(4000))[: len(speed)] * 50.0
    leaky = {**recording.channels, "force": Channel("force", "N", force.stamps_ns[: len(sums)], sums)}
    rules = parse_rules({"force": {"lags": [1]}, "speed": {"lags": [0]}, "products": [["force"], ["speed"]]}, "test")
    stable = assemble_problem([prepare(replace(recording, channels=leaky), SAMPLING)], rules.candidates())
    free = replace(stable, max_gain=np.inf)
    chosen, begin = np.array([0, 1]), np.array([0.9, 50.0])
    inside = fit_free_run(stable, chosen, begin, stable.everything, 60)
    outside = fit_free_run(free, chosen, begin, stable.everything, 60)
    assert outside.coefficients[0] > stable.max_gain
    assert 0.98 < inside.coefficients[0] < stable.max_gain
    assert inside.error > outside.error
