"""The parts of `make tables` that its figures stand on: the damper on estimates, one-step training, markers, store."""

from dataclasses import replace

import numpy as np
import pytest

from bench.markdown import between, markdown, replace_between
from bench.thesis import models, tables
from bench.thesis.models import (
    OURS,
    POLYNOMIAL,
    THESIS,
    TrainingJob,
    TrainingOutcome,
    load_named_experiment,
    train_jobs,
)
from bench.thesis.one_step import OneStepFuzzy, OneStepNetwork
from bench.thesis.plant import PULL, integrate_speed, plant_cost
from bench.thesis.tables import ROWS, evaluate_outcome, jobs, table
from ces_identify.preparation.series import prepare
from ces_identify.trained.fuzzy_fit import PremiseGrid
from ces_identify.trained.training import Lags, build_regressors, build_training
from ces_observer.model import Sampling
from ces_rig.experiment import run
from ces_rig.sensors import Sensor, Sensors

SAMPLING = Sampling(1000.0, 119.0, 0.01)
PERFECT = Sensors(Sensor(), Sensor(), Sensor())


def short(name, **changes):
    experiment = load_named_experiment(name, fresh=False)
    settings = replace(experiment.settings, duration_s=3.0)
    return replace(experiment, settings=settings, **changes)


@pytest.fixture(scope="module")
def noisy():
    experiment = short("sine_4hz")
    return experiment, prepare(run(experiment), SAMPLING)


def test_speed_is_integrated_to_the_stroke_it_belongs_to():
    time = np.arange(4000) * 1e-3
    stroke = 0.02 * np.sin(2 * np.pi * 4.0 * time)
    speed = 0.02 * 2 * np.pi * 4.0 * np.cos(2 * np.pi * 4.0 * time)
    np.testing.assert_allclose(integrate_speed(speed, stroke, 1e-3), stroke, atol=2e-6)


def test_an_offset_of_the_speed_does_not_drift_away():
    nothing = np.zeros(5000)
    stroke = integrate_speed(nothing + 0.01, nothing, 1e-3)
    assert stroke[0] == 0.0
    assert stroke[-1] == pytest.approx(0.01 / PULL, rel=1e-6)


def test_the_damper_on_perfect_sensors_is_left_with_the_differentiator_alone(noisy):
    perfect = short("sine_4hz", sensors=PERFECT)
    cost = plant_cost(perfect, prepare(run(perfect), SAMPLING))
    assert cost < 0.35
    assert plant_cost(*noisy) > 2.0 * cost


def test_another_damper_costs_more_on_the_same_estimates(noisy):
    experiment, series = noisy
    stiffer = replace(experiment.damper, body=replace(experiment.damper.body, bore_m=0.040))
    assert plant_cost(replace(experiment, damper=stiffer), series) > 5.0 * plant_cost(experiment, series)


def family(kind, series):
    data = build_training([series])
    lags = build_regressors(data, Lags(), 1000.0)
    if kind is OneStepNetwork:
        return kind(data, lags, 4, 0.0)
    return kind(data, lags, (PremiseGrid("speed", 0, 3),), 0.0)


@pytest.mark.parametrize("kind", [OneStepNetwork, OneStepFuzzy])
def test_one_step_errors_use_measured_past_forces_and_so_vanish_on_a_model_s_own_force(noisy, kind):
    fit = family(kind, noisy[1])
    params = fit.start(np.random.default_rng(1))
    own = fit.force(params)
    assert np.isfinite(own).all()
    planted = replace(fit, training=replace(fit.training, measured=own))
    price = fit._regularisation(params)[0] @ fit._regularisation(params)[1] ** 2 if kind is OneStepFuzzy else 0.0
    assert planted.errors(params, np.inf)[0] == pytest.approx(price, abs=1e-12)
    assert fit.errors(params, np.inf)[0] > price + 1e-8


@pytest.mark.parametrize("kind", [OneStepNetwork, OneStepFuzzy])
def test_one_step_gradient_is_that_of_finite_differences(noisy, kind):
    fit = family(kind, noisy[1])
    params = fit.start(np.random.default_rng(1))
    _, _, gradient = fit.errors(params, np.inf)
    direction = np.random.default_rng(2).normal(size=len(params))
    step = 1e-6 * direction
    rise = fit.errors(params + step, np.inf)[0] - fit.errors(params - step, np.inf)[0]
    assert -2.0 * gradient @ direction == pytest.approx(rise / 2e-6, rel=1e-4)


def test_only_what_is_between_the_markers_is_replaced(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- a: begin (how) -->\nold\n<!-- a: end -->\nafter\n")
    replace_between(path, "a", "new\n\nlines")
    replace_between(path, "a", "newer\n\nlines")
    assert path.read_text() == "before\n<!-- a: begin (how) -->\nnewer\n\nlines\n<!-- a: end -->\nafter\n"
    with pytest.raises(ValueError, match="no markers 'b: begin'"):
        between(path, "b")


def test_markdown_aligns_figures_to_the_right():
    assert markdown([["a", "J %"], ["x", "1"]]) == "| a | J % |\n|---|---:|\n| x | 1 |"


def test_thesis_figures_stand_in_table_5_1_alone_and_missing_models_are_said(monkeypatch):
    monkeypatch.setattr(tables, "noise_floor", lambda name: 0.5)
    judged = {(s, p, row): None for s in (POLYNOMIAL, "anfis") for p in (THESIS, OURS) for row in ROWS}
    polynomial, anfis = (table(s, judged).splitlines()[2:] for s in (POLYNOMIAL, "anfis"))
    assert [line.split(" | ")[1] for line in polynomial] == ["2.34", "6.92", "14.79", "63.8", "136"]
    assert {line.split(" | ")[1] for line in anfis} == {"not available to us"}
    assert all(line.count("none stable") == 2 for line in polynomial + anfis)


def test_every_table_has_its_jobs_once():
    wanted = jobs()
    assert len(wanted) == len(set(wanted)) == 20
    assert {j.terms for j in wanted if j.sources == ("noise", "sweep")} == {25, 40}


def test_a_model_is_trained_once_kept_and_judged_on_another_run(tmp_path, monkeypatch):
    monkeypatch.setattr(models, "code_digest", lambda: "fixed")
    monkeypatch.setattr(models, "POLYNOMIAL_STARTS", 1)
    job = TrainingJob(POLYNOMIAL, THESIS, ("sine_4hz",), terms=3)
    first, again = (dict(train_jobs([job], 120.0, 1, tmp_path))[job] for _ in range(2))
    assert first.seconds == again.seconds, "the second time it comes from the store"
    assert 1 <= len(first.model.body.terms) <= 3
    recording = run(load_named_experiment("sine_4hz", fresh=True))
    assert 0.5 < evaluate_outcome(first, recording).cost < 60.0
    assert evaluate_outcome(TrainingOutcome(None, "why", 0.0), recording) is None
