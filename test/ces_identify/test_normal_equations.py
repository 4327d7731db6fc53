"""Errors, matrices and gradients of networks and neuro-fuzzy models against finite differences of the slow free run."""

from dataclasses import replace

import numpy as np
import pytest
from planted import FUZZY, NETWORK, SAMPLING, planted

from ces_identify.numerics.least_squares import BLOCK, accumulate, evaluate, mirror
from ces_identify.prepare.series import prepare
from ces_identify.structures.fuzzy import FuzzyFit, PremiseGrid
from ces_identify.structures.network import KINK, NetworkFit
from ces_identify.training import build_training


def data(seconds=5.0):
    t = build_training([prepare(planted(NETWORK, 1, seconds=seconds), SAMPLING), prepare(planted(FUZZY, 2), SAMPLING)])
    return replace(t, force_envelope=(-1e6, 1e6))


def regressors(t):
    named = (("force", 1), ("force", 3), ("speed", 0), ("speed", 2), ("current", 1))
    return tuple(replace(t.regressor(s, lag), mean=0.1 if s == "force" else 0.2) for s, lag in named)


def network(t):
    return NetworkFit(t, regressors(t), 3, 1e-3)


def fuzzy(t):
    return FuzzyFit(t, regressors(t), (PremiseGrid("speed", 0, 3), PremiseGrid("current", 1, 2)), 1e-3)


FITS = [network, fuzzy]


def parameters(fit):
    """Parameters with a lively past that is still far from unstable."""
    random = np.random.default_rng(5)
    params = fit.start(random)
    if isinstance(fit, FuzzyFit):
        consequents, _ = fit.parts(params)
        consequents += random.normal(0.0, 0.05, consequents.shape)
    else:
        params += random.normal(0.0, 0.05, len(params))
    return params


def slow_force(fit, params):
    run = fit.model(params, SAMPLING).make_predictor()
    out = np.zeros(len(fit.training.measured))
    for start, stop in fit.training.segments:
        run.reset()
        for k in range(start, stop):
            out[k] = run.tick(*fit.training.inputs[:, k].tolist())
    return out


@pytest.mark.parametrize("make", FITS)
def test_force_of_parameters_is_that_of_their_model(make):
    fit = make(data())
    params = parameters(fit)
    np.testing.assert_allclose(fit.force(params), slow_force(fit, params), rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("make", FITS)
def test_matrix_and_gradient_are_those_of_finite_differences(make):
    fit = make(data())
    params, t = parameters(fit), fit.training
    _, matrix, gradient = fit.equations(params, np.inf)
    jacobian = np.empty((len(t.measured), len(params)))
    for p in range(len(params)):
        step = np.zeros_like(params)
        step[p] = 1e-5
        jacobian[:, p] = (fit.force(params + step) - fit.force(params - step)) / 2e-5
    errors = t.measured - fit.force(params)
    expected = jacobian.T @ (t.estimation[:, None] * jacobian)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(matrix - expected).max() > 0.0
    assert (np.abs(matrix - expected) <= 1e-5 * size + 1e-12).all()
    np.testing.assert_allclose(
        gradient, jacobian.T @ (t.estimation * errors), rtol=1e-4, atol=1e-5 * np.abs(gradient).max()
    )


@pytest.mark.parametrize("make", FITS)
def test_error_is_that_of_the_free_run_on_the_estimation_ticks_and_its_regularisation(make):
    fit = make(data())
    params, t = parameters(fit), fit.training
    plain = float(t.estimation @ (t.measured - fit.force(params)) ** 2)
    assert fit.equations(params, np.inf).error == pytest.approx(plain, rel=1e-9)
    assert evaluate(fit.equations, [fit.pull], params).value > plain
    assert fit.equations(params, 0.5 * plain).error == np.inf


@pytest.mark.parametrize("make", FITS)
def test_regularisation_bend_error_and_gradient_alike(make):
    fit = make(data())
    params = parameters(fit)
    _, matrix, gradient = fit.pull(params)
    direction = np.random.default_rng(1).normal(size=len(params))
    direction /= np.linalg.norm(direction)

    def price(at):
        return fit.pull(at).error

    h = 1e-3
    slope = (price(params + h * direction) - price(params - h * direction)) / (2 * h)
    assert -2.0 * gradient @ direction == pytest.approx(slope, rel=1e-4)
    curve = (price(params + h * direction) - 2 * price(params) + price(params - h * direction)) / h**2
    assert 2.0 * direction @ matrix @ direction == pytest.approx(curve, rel=1e-3)


@pytest.mark.parametrize("make", FITS)
def test_gains_are_the_proved_ones_but_for_rounded_kinks_and_their_slopes_right(make):
    fit = make(data())
    params = parameters(fit)
    gains, slopes = fit.gains(params)
    proved = fit.model(params, SAMPLING).certify().gain
    kinks = fit.units * KINK * len(fit.past) if isinstance(fit, NetworkFit) else 0.0
    assert proved - 1e-12 <= gains.max() <= proved + kinks + 1e-12
    for p in range(len(params)):
        step = np.zeros_like(params)
        step[p] = 1e-7
        moved = (fit.gains(params + step)[0] - fit.gains(params - step)[0]) / 2e-7
        np.testing.assert_allclose(slopes[:, p], moved, atol=1e-6)


def test_blocks_and_tiles_leave_no_tick_out():
    random = np.random.default_rng(0)
    slopes, errors = random.normal(size=(BLOCK + 13, 5)), random.normal(size=BLOCK + 13)
    weights = random.uniform(0, 1, BLOCK + 13) * (random.random(BLOCK + 13) < 0.4)
    matrix, gradient = np.zeros((5, 5)), np.zeros(5)
    total = accumulate(matrix, gradient, slopes, errors, weights)
    mirror(matrix)
    np.testing.assert_allclose(matrix, slopes.T @ (weights[:, None] * slopes), rtol=1e-12)
    np.testing.assert_allclose(gradient, slopes.T @ (weights * errors), rtol=1e-12)
    assert total == pytest.approx(weights @ errors**2, rel=1e-12)
