"""Gated experts: exact derivatives, limits that hold for any parameters, and a fit that forgets in the stated time."""

from __future__ import annotations

import numpy as np
import pytest
from planted import NETWORK, RATE_HZ, planted

from ces_identify.numerics.search import Limits
from ces_identify.prepare.cost import series_cost
from ces_identify.prepare.series import prepare
from ces_identify.structures import run_batch
from ces_identify.structures.experts import ExpertsFit, choose_lags, fit_experts
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.training import Lags, build_regressors, build_training
from ces_observer.structures.mixture import Mixture


@pytest.fixture(scope="module")
def family():
    training = build_training([prepare(planted(NETWORK, 1, 4.0), NETWORK.sampling)])
    past, *inputs = build_regressors(training, Lags((1,), (0.0, 0.0025), (0.0,)), RATE_HZ)
    return ExpertsFit(training, (*inputs, past), 3, 0.99, 1e-6)


def test_the_gradient_is_that_of_the_error(family):
    params = family.start(np.random.default_rng(3))
    gradient, step = family.differentiate(params).gradient, 1e-6
    for k in (0, 5, 13, 25, *range(family.rows, len(params))):
        moved = step * np.eye(len(params))[k]
        slope = (family.error(params - moved) - family.error(params + moved)) / (4.0 * step)
        assert gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-8)


def test_no_parameters_leave_the_limit(family):
    for seed in range(20):
        params = np.random.default_rng(seed).normal(0.0, 30.0, len(family.centre))
        params[family.rows + 2 :: 3] = 0.0
        assert family.body(params).certify(family.within).gain <= 0.99 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("rate_Hz", "ticks"), [(100.0, [0, 1, 2, 3]), (200.0, [0, 1, 2, 3]), (1000.0, [0, 1, 3, 7, 15])]
)
def test_inputs_are_seen_over_15_ms_and_at_four_ticks_at_least(rate_Hz, ticks):
    assert [round(lag * rate_Hz) for lag in choose_lags(rate_Hz)] == ticks


@pytest.mark.slow
def test_a_fit_follows_a_planted_model_and_forgets_in_time():
    series, fresh = (prepare(planted(NETWORK, seed), NETWORK.sampling) for seed in (1, 2))
    options = IdentifyOptions(limits=Limits(starts=3, threads=2), forget=2.0)
    fitted = fit_experts(4, [series], NETWORK.sampling, options, lambda result: None)
    assert isinstance(fitted.model.body, Mixture) and len(fitted.model.body.members) == 3
    assert fitted.results[0].cost < 5.0
    assert fitted.model.certify().forgets_s <= 2.0
    refitted = fitted.refit(np.ones(len(series)))
    assert refitted is not None and refitted.is_stable()
    assert series_cost(fresh, run_batch(fitted.model, fresh.inputs, fresh.segments)[0]) < 8.0
