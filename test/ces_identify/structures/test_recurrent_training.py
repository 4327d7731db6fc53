"""Recurrent networks: exact derivatives, the batch run, a planted damper found again, residuals over a base."""

from dataclasses import replace

import numpy as np
import pytest
from planted import NETWORK, SAMPLING, planted, with_values
from recurrent_models import recurrent_model

from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.prepare.cost import series_cost
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures import KITS, model_section, run_batch
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.recurrent import Windows, descend, fit_recurrent
from ces_identify.structures.recurrent_network import (
    build_family,
    new_states,
    run_member,
    run_member_back,
)
from ces_identify.training import build_training
from ces_observer.errors import CesError
from ces_observer.model import parse_model

SHORT = Limits(starts=1, threads=1, work=0.06)


def silent(result):
    del result


def series(seed=1, **values):
    recording = planted(NETWORK, seed)
    return prepare(with_values(recording, **values) if values else recording, SAMPLING)


def still(count):
    return np.full(count, 0.5)


def family(current=True):
    one = series() if current else series(current=still(4000))
    return build_family(build_training([one]), SAMPLING.rate_Hz)


@pytest.mark.parametrize("current", [True, False])
def test_derivatives_are_those_of_differences(current):
    fit, random = family(current), np.random.default_rng(2)
    params = fit.start(random) + random.normal(0.0, 0.1, fit.size)
    motion, currents = (rows[:, 500:560].reshape(len(rows), 20, 3) for rows in fit.rows)
    wanted = random.normal(0.0, 1.0, (20, 3))

    def error(changed):
        arrays = fit.arrays(changed)
        force, traces = run_member(arrays, motion, currents, new_states(arrays, 3))
        back = run_member_back(arrays, traces, 2.0 * (force - wanted))
        return float(((force - wanted) ** 2).sum()), fit.gradient(changed, back)

    _, gradient = error(params)
    for k in range(0, fit.size, 7):
        step = np.zeros(fit.size)
        step[k] = 1e-5
        difference = (error(params + step)[0] - error(params - step)[0]) / 2e-5
        assert gradient[k] == pytest.approx(difference, rel=1e-5, abs=1e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("current", [True, False])
def test_batch_run_is_that_of_ticks_and_of_the_parameters(current):
    fit = family(current)
    params = [fit.start(np.random.default_rng(seed)) for seed in (1, 2)]
    t = fit.training
    model = recurrent_model(fit.body(params), sampling=SAMPLING, envelope=t.envelope, force_envelope_N=(-300.0, 400.0))
    force, held = run_batch(model, t.inputs, t.segments)
    expected = np.clip(fit.force(params), *model.force_envelope_N)
    np.testing.assert_allclose(force, expected, rtol=1e-9, atol=1e-9)
    run = model.make_predictor()
    ticks = [(run.tick(*column), run.held) for column in t.inputs[:, :2000].T.tolist()]
    np.testing.assert_allclose(force[:2000], [one for one, _ in ticks], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(held[:2000], [one for _, one in ticks])
    assert held.any()


def test_windows_lie_on_ticks_with_a_weight_and_one_stays_at_rest():
    t = build_training([series()])
    windows = Windows.of(t, SAMPLING.rate_Hz, t.estimation)
    at, weights = windows.draw(np.random.default_rng(1))
    assert (t.estimation[at[windows.unscored :, :-1]] > 0.0).mean() > 0.5
    assert (np.diff(at[:, :-1], axis=0) == 1).all()
    assert (at[:, -1] == at[0, -1]).all()
    assert (weights[: windows.unscored] == 0.0).all()
    assert at.max() < len(t.measured)


def test_recordings_shorter_than_a_window_can_be_fitted():
    t = build_training([series().part(0.0, 0.5)])
    t = replace(t, segments=np.array([[a, a + 200] for a in range(0, 2000, 200)]))
    fit = build_family(t, SAMPLING.rate_Hz)
    *_, params = descend(fit, t.estimation, fit.start(np.random.default_rng(1)), np.random.default_rng(2), 5)
    assert np.isfinite(params).all()


@pytest.fixture(scope="module")
def fitted():
    return fit_recurrent([series(1), series(2)], SAMPLING, IdentifyOptions(limits=SHORT), silent)


def test_a_planted_damper_is_found_and_certified(fitted):
    fresh = series(3)
    assert series_cost(fresh, simulate_series(fitted.model, fresh).force) < 12.0
    again = parse_model(fitted.model.to_json(), "m.json")
    assert again.body == fitted.model.body
    assert again.certificate == again.certify().to_mapping()
    assert fitted.how["parameters"] == fitted.model.body.parameters == len(fitted.results[0].coefficients)


def test_the_same_seed_gives_the_same_model(fitted):
    again = fit_recurrent([series(1), series(2)], SAMPLING, IdentifyOptions(limits=replace(SHORT, threads=3)), silent)
    assert again.model == fitted.model


def test_a_report_lists_the_stages(fitted):
    table = model_section(fitted.model, (), "validation").table
    assert len(table.rows) == 3
    assert all(len(row) == len(table.columns) for row in table.rows)


def test_a_refit_sees_only_the_weighted_ticks(fitted):
    weights = np.ones(len(series(1)) + len(series(2)))
    weights[: len(weights) // 2] = 0.0
    model = fitted.refit(weights)
    assert model.body != fitted.model.body
    assert model.certify().holds


def test_several_starts_are_averaged_if_that_is_better():
    heard = []
    limits = Limits(starts=2, threads=2, work=0.05)
    fit = fit_recurrent([series(1)], SAMPLING, IdentifyOptions(limits=limits), heard.append)
    assert fit.results[0].cost == min(one.cost for one in heard if not isinstance(one, str))
    assert fit.model.body.parameters == len(fit.results[0].coefficients)


def test_a_hard_end_keeps_the_best_so_far():
    limits = Limits(time=0.05, starts=1, threads=1)
    fit = fit_recurrent([series(1)], SAMPLING, IdentifyOptions(limits=limits), silent)
    assert np.isfinite(fit.results[0].cost)
    assert "steps exhausted" not in fit.results[0].ended


def test_constant_inputs_drop_out_and_a_constant_speed_is_refused():
    assert family(current=False).current == ()
    t = build_training([series()])
    inputs = t.inputs.copy()
    inputs[0] = 0.01
    assert [one.signal for one in build_family(replace(t, inputs=inputs), 400.0).motion] == [
        "speed",
        "speed_root",
        "speed_size",
    ]
    inputs[1] = 0.2
    with pytest.raises(CesError, match="the speed does not change"):
        build_family(replace(t, inputs=inputs), 400.0)


@pytest.mark.slow
def test_it_is_identified_by_its_name_with_a_band():
    recordings = [planted(NETWORK, 1), planted(NETWORK, 2)]
    options = IdentifyOptions(split=1.0, limits=SHORT, rate=SAMPLING.rate_Hz)
    result = identify(recordings, [planted(NETWORK, 3, name="fresh")], options, silent, KITS["recurrent"].fitter({}))
    fresh = next(e for e in result.evaluations if e.name == "fresh")
    assert 0.8 <= fresh.coverage <= 0.99
