import numpy as np
import pytest
from planted import NETWORK, SAMPLING, planted

from ces_identify.prepare.cost import cost
from ces_identify.prepare.series import prepare
from ces_identify.trained.training import Lags, build_regressors, build_training
from ces_observer.errors import RecordingError


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
