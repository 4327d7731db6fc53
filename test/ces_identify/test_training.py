"""Training data and regressors of networks and neuro-fuzzy models: ticks, lags, counts, and models without memory."""

import numpy as np
import pytest
from planted import FUZZY, NETWORK, RATE_HZ, SAMPLING, planted, with_values

import ces_identify
from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures.fuzzy import CURRENT_AND_SPEED, FuzzyShape
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.training import (
    LagCounts,
    Lags,
    build_regressors,
    build_training,
)
from ces_observer.errors import CesError, RecordingError


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
        ("sigmoid", {"lags": "2,4"}, "structure 'sigmoid': '2,4' is not Y,C,V, such as 2,4,5"),
        ("anfis", {"rules": "4"}, "structure 'anfis': '4' is not VxI, such as 7x2"),
    ],
)
def test_a_wrong_size_is_one_line_in_a_script(structure, size, message):
    with pytest.raises(CesError, match=message):
        ces_identify.identify(planted(NETWORK, 1), structure=structure, **size)


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
