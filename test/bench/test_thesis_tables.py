"""The parts of `make tables` that its figures stand on: rows, costs, one-step training, the damper, markers, store."""

from dataclasses import replace

import numpy as np
import pytest

from bench.markdown import between, replace_between
from bench.thesis import models
from bench.thesis.costs import evaluate_outcome, integrate_speed, make_job, plant_cost
from bench.thesis.models import (
    ANFIS,
    NETWORK,
    OURS,
    POLYNOMIAL,
    STARTS,
    TABLES,
    THESIS,
    OneStepNetwork,
    TrainingOutcome,
    load_named_experiment,
    train_jobs,
)
from bench.thesis.plots import ROWS, draw
from bench.thesis.tables import jobs
from ces_identify.prepare.series import prepare
from ces_identify.trained.training import Lags, build_regressors, build_training
from ces_observer.model import Sampling
from ces_rig.experiment import packaged_experiments, run
from ces_rig.sensors import Sensor, Sensors

SAMPLING = Sampling(1000.0, 1.5e-5, 0.3, (-0.1, 0.1), 0.01)
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


def test_the_damper_on_perfect_sensors_is_left_with_the_estimate_of_the_speed_alone(noisy):
    perfect = short("sine_4hz", sensors=PERFECT)
    cost = plant_cost(perfect, prepare(run(perfect), replace(SAMPLING, noise_m=1e-6)))
    assert cost < 0.35
    assert plant_cost(*noisy) > 2.0 * cost


@pytest.fixture(scope="module")
def one_step(noisy):
    data = build_training([noisy[1]])
    return OneStepNetwork(data, build_regressors(data, Lags(), 1000.0), 4, 0.0)


def test_one_step_errors_use_measured_past_forces_and_so_vanish_on_a_model_s_own_force(one_step):
    params = one_step.start(np.random.default_rng(1))
    own = one_step.force(params)
    assert np.isfinite(own).all()
    planted = replace(one_step, training=replace(one_step.training, measured=own))
    assert planted.errors(params, np.inf)[0] == pytest.approx(0.0, abs=1e-12)
    assert one_step.errors(params, np.inf)[0] > 1e-8


def test_one_step_gradient_is_that_of_finite_differences(one_step):
    params = one_step.start(np.random.default_rng(1))
    _, _, gradient = one_step.errors(params, np.inf)
    direction = np.random.default_rng(2).normal(size=len(params))
    step = 1e-6 * direction
    rise = one_step.errors(params + step, np.inf)[0] - one_step.errors(params - step, np.inf)[0]
    assert -2.0 * gradient @ direction == pytest.approx(rise / 2e-6, rel=1e-4)


def test_only_what_is_between_the_markers_is_replaced(tmp_path):
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- a: begin (how) -->\nold\n<!-- a: end -->\nafter\n")
    replace_between(path, "a", "new\n\nlines")
    replace_between(path, "a", "newer\n\nlines")
    assert path.read_text() == "before\n<!-- a: begin (how) -->\nnewer\n\nlines\n<!-- a: end -->\nafter\n"
    with pytest.raises(ValueError, match="no markers 'b: begin'"):
        between(path, "b")


def test_tables_have_the_rows_of_the_thesis():
    assert {structure: len(table.rows) for structure, table in TABLES.items()} == {POLYNOMIAL: 7, NETWORK: 6, ANFIS: 5}
    known, wanted = packaged_experiments(), jobs()
    rows = [row for table in TABLES.values() for row in table.rows]
    assert all(f"thesis/{name}" in known for row in rows for name in (row.source, row.target))
    assert len(wanted) == len(set(wanted)) == 29, "every model is trained once"


@pytest.mark.slow
def test_a_model_is_trained_once_kept_judged_on_another_run_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(models, "code_digest", lambda: "fixed")
    monkeypatch.setitem(STARTS, POLYNOMIAL, 1)
    job = make_job(POLYNOMIAL, THESIS, TABLES[POLYNOMIAL].rows[0])
    first, again = (dict(train_jobs([job], 1.0, 1, tmp_path))[job] for _ in range(2))
    assert first.seconds == again.seconds, "the second time it comes from the store"
    assert 1 <= len(first.model.body.terms) <= 7
    evaluation = evaluate_outcome(first, run(load_named_experiment("thesis/sine_4hz", fresh=True)), clamped=False)
    assert 0.5 < evaluation.cost < 60.0
    assert evaluation.clamped_share == 0.0
    assert evaluate_outcome(TrainingOutcome(None, "why", 0.0), None) is None
    draw({(POLYNOMIAL, p, row): evaluation for p in (THESIS, OURS) for row in ROWS}, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
