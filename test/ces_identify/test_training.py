"""Training data of networks and neuro-fuzzy models; their errors, matrices and gradients against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted import FUZZY, NETWORK, RATE_HZ, SAMPLING, planted, with_values

import ces
from ces_identify.identification import identify
from ces_identify.numerics.least_squares import BLOCK, accumulate, evaluate, mirror
from ces_identify.numerics.search import Limits
from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures.fuzzy import CURRENT_AND_SPEED, FuzzyFit, FuzzyShape, PremiseGrid
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.network import KINK, NetworkFit
from ces_identify.training import (
    LagCounts,
    Lags,
    build_regressors,
    build_training,
    delay_values,
    regressor_table,
)
from ces_observer.errors import CesError, RecordingError
from ces_observer.model import Envelope
from ces_observer.structures.lagged_signals import Regressor


@pytest.fixture(scope="module")
def data():
    return build_training([prepare(planted(NETWORK, 1), SAMPLING), prepare(planted(NETWORK, 2, seconds=6.0), SAMPLING)])


def test_no_tick_is_both_fitted_and_chosen_by(data):
    assert not (data.estimation * data.selection).any()
    assert (data.estimation > 0).sum() > 1.5 * (data.selection > 0).sum() > 0


def test_cost_is_the_mean_of_each_recordings_J(data):
    force = data.measured + np.random.default_rng(0).normal(0, 30.0, len(data.measured))
    parts = []
    for start, stop in data.segments:
        chosen = np.flatnonzero(data.selection[start:stop]) + start
        parts.append(cost(data.measured[chosen], force[chosen]))
    assert len(parts) == 2
    assert data.cost(force, data.selection) == pytest.approx(np.mean(parts), rel=1e-9)
    force[0] = np.nan
    assert data.cost(force, data.selection) == np.inf


def test_regressors_have_mean_zero_and_spread_one_and_whole_ticks(data):
    chosen = build_regressors(data, Lags((1, 2), (0.0, 0.0001, 0.005), (0.01,), ()), 400.0)
    assert [(r.signal, r.lag) for r in chosen] == [
        ("force", 1),
        ("force", 2),
        ("speed", 0),
        ("speed", 2),
        ("current", 4),
    ]
    assert chosen[2].spread == pytest.approx(data.inputs[1].std())
    assert chosen[0].mean == 0.0
    assert data.changing_inputs() == {"position", "speed", "current"}


def test_the_force_envelope_holds_zero_where_every_run_begins(data):
    assert data.force_envelope[0] < 0.0 < data.force_envelope[1]


def test_too_little_is_refused():
    with pytest.raises(RecordingError, match=r"at least|too short|warm-up"):
        build_training([prepare(planted(NETWORK, 3, seconds=0.7), SAMPLING)])


def test_delays_do_not_cross_segments():
    segments = np.array([[0, 3], [3, 7]])
    np.testing.assert_array_equal(delay_values(np.arange(7.0), 2, segments), [0, 0, 0, 3, 3, 3, 4])


def test_a_table_is_clamped_then_scaled_and_leaves_room_for_past_forces():
    envelope = Envelope((-1.0, 1.0), (-0.5, 0.5), (0.0, 1.0))
    regressors = (
        Regressor("speed", 1, 0.25, 0.5),
        Regressor("force", 3, 10.0, 50.0),
        Regressor("current", 0, 0.0, 2.0),
    )
    inputs = np.array([[0.0, 0.0, 0.0], [0.1, 9.0, -9.0], [0.5, 2.0, -1.0]])
    table = regressor_table(regressors, envelope, inputs, np.array([[0, 3]]))
    np.testing.assert_allclose(table.values[:, 0], [-0.3, -0.3, 0.5])
    np.testing.assert_array_equal(table.values[:, 1], 0.0)
    np.testing.assert_allclose(table.values[:, 2], [0.25, 0.5, 0.0])
    assert [a.tolist() for a in table[1:]] == [[0, 3, 0], [0.0, 10.0, 0.0], [1.0, 50.0, 1.0]]


OPTIONS = IdentifyOptions(1.0, limits=Limits(time=20.0, starts=1, threads=1), rate=RATE_HZ)


def regressors(counts, rate_Hz=RATE_HZ, recording=None):
    series = prepare(recording or planted(NETWORK, 1), SAMPLING)
    return [(r.signal, r.lag) for r in build_regressors(build_training([series]), counts, rate_Hz)]


@pytest.mark.parametrize("rate_Hz", [120.0, RATE_HZ, 1000.0, 1234.5])
def test_counts_are_ticks_at_every_rate(rate_Hz):
    assert regressors(LagCounts(2, 1, 3), rate_Hz) == [
        *(("force", 1), ("force", 2), ("speed", 0), ("speed", 1), ("speed", 2), ("current", 0))
    ]


@pytest.mark.parametrize(
    ("structure", "size", "message"),
    [
        ("sigmoid", {"lags": "2,4"}, "lags: '2,4' is not Y,C,V, such as 2,4,5"),
        ("anfis", {"rules": "4"}, "rules: '4' is not VxI, such as 7x2"),
    ],
)
def test_a_wrong_size_is_one_line_in_a_script(structure, size, message):
    with pytest.raises(CesError, match=message):
        ces.identify(planted(NETWORK, 1), structure=structure, **size)


def test_a_constant_current_alone_leaves_nothing_to_use():
    varied = planted(NETWORK, 4)
    fixed = with_values(varied, current=np.full(len(varied.channel("current")), 0.5))
    assert regressors(LagCounts(1, 3, 1), recording=fixed) == [("force", 1), ("speed", 0)]
    with pytest.raises(CesError, match="every input among the regressors is constant"):
        regressors(LagCounts(0, 3, 0), recording=fixed)


def test_memberships_of_current_and_speed_make_a_model_without_memory():
    shape = FuzzyShape(3, 2, current_delay_s=0.0, lags=CURRENT_AND_SPEED)
    model = identify([planted(FUZZY, 1)], [], OPTIONS, fitter=shape).model
    body = model.body
    assert [(p.signal, p.lag, len(p.memberships)) for p in body.premises] == [("speed", 0, 3), ("current", 0, 2)]
    assert {(r.signal, r.lag) for r in body.regressors} == {("speed", 0), ("current", 0)}
    assert (len(body.rules), model.certificate["gain"]) == (6, 0.0)
    series = prepare(planted(FUZZY, 2), SAMPLING)
    forces = simulate_series(model, series).force
    predictor = model.make_predictor()
    for k in np.flatnonzero(series.scored)[::97]:
        predictor.reset()
        tick = predictor.tick(float(series.position[k]), float(series.speed[k]), float(series.current[k]))
        assert tick == pytest.approx(forces[k], rel=1e-9)


def two_dampers(seconds=5.0):
    t = build_training([prepare(planted(NETWORK, 1, seconds=seconds), SAMPLING), prepare(planted(FUZZY, 2), SAMPLING)])
    return replace(t, force_envelope=(-1e6, 1e6))


def shifted_regressors(t):
    named = (("force", 1), ("force", 3), ("speed", 0), ("speed", 2), ("current", 1))
    return tuple(replace(t.regressor(s, lag), mean=0.1 if s == "force" else 0.2) for s, lag in named)


def network(t):
    return NetworkFit(t, shifted_regressors(t), 3, 1e-3)


def fuzzy(t):
    return FuzzyFit(t, shifted_regressors(t), (PremiseGrid("speed", 0, 3), PremiseGrid("current", 1, 2)), 1e-3)


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
    fit = make(two_dampers())
    params = parameters(fit)
    np.testing.assert_allclose(fit.force(params), slow_force(fit, params), rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("make", FITS)
def test_matrix_and_gradient_are_those_of_finite_differences(make):
    fit = make(two_dampers())
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
    fit = make(two_dampers())
    params, t = parameters(fit), fit.training
    plain = float(t.estimation @ (t.measured - fit.force(params)) ** 2)
    assert fit.equations(params, np.inf).error == pytest.approx(plain, rel=1e-9)
    assert evaluate(fit.equations, [fit.pull], params).value > plain
    assert fit.equations(params, 0.5 * plain).error == np.inf


@pytest.mark.parametrize("make", FITS)
def test_regularisation_bend_error_and_gradient_alike(make):
    fit = make(two_dampers())
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
    fit = make(two_dampers())
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
