"""The parts of `make tables` that its figures stand on: rows, costs, one-step training, the damper, markers, store."""

from collections import Counter
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from bench.markdown import between, markdown, replace_between
from bench.thesis import models, tables
from bench.thesis.costs import PULL, evaluate_outcome, integrate_speed, make_job, percent, plant_cost
from bench.thesis.models import (
    ANFIS,
    NETWORK,
    OURS,
    POLYNOMIAL,
    PUBLISHED,
    REGRESSORS,
    STARTS,
    TABLES,
    THESIS,
    OneStepNetwork,
    TrainingJob,
    TrainingOutcome,
    format_size,
    load_named_experiment,
    make_shape,
    train_jobs,
)
from bench.thesis.plots import ROWS, draw
from bench.thesis.tables import format_table, jobs
from ces_identify.polynomial.candidates import load_rules
from ces_identify.prepare.series import prepare
from ces_identify.trained.training import Lags, build_regressors, build_training
from ces_observer.model import Sampling
from ces_rig.experiment import packaged_experiments, run
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


def test_markdown_aligns_figures_to_the_right():
    assert markdown([["a", "J %"], ["x", "1"]]) == "| a | J % |\n|---|---:|\n| x | 1 |"


def test_tables_have_the_rows_sizes_and_costs_of_the_thesis():
    printed = {s: [(row.cost, format_size(row)) for row in table.rows] for s, table in TABLES.items()}
    assert printed == {
        POLYNOMIAL: [
            (2.34, "7"), (1.77, "10"), (1.63, "11"), (14.79, "9"), (6.92, "5"), (63.79, "5"), (136.24, "9"),
        ],
        NETWORK: [
            (1.24, "2, 2, 2; 15"), (2.72, "2, 2, 2; 20"), (22.02, "2, 2, 2; 20"),
            (11.24, "2, 3, 3; 16"), (9.86, "2, 4, 5; 30"), (38.87, "2, 4, 5; 30"),
        ],
        ANFIS: [(2.12, "4 x 4"), (3.38, "4 x 4"), (6.6, "3 x 3"), (5.2, "6 x 6"), (None, "4 x 4")],
    }  # fmt: skip
    known = packaged_experiments()
    assert all(
        f"thesis/{name}" in known for t in TABLES.values() for row in t.rows for name in (row.source, row.target)
    )


def test_every_model_is_trained_once_and_each_procedure_has_the_thesis_size():
    wanted = jobs()
    assert len(wanted) == len(set(wanted))
    counts = Counter((job.structure, job.procedure) for job in wanted)
    assert counts == {(POLYNOMIAL, p): n for p, n in ((OURS, 5), (THESIS, 5), (PUBLISHED, 3))} | {
        (s, p): 4 for s in (NETWORK, ANFIS) for p in (OURS, THESIS)
    }
    for job in wanted:
        if job.procedure == PUBLISHED:
            name = job.sources[0].removeprefix("thesis/")
            assert len(load_rules(REGRESSORS / f"{name}.yaml").initial_terms()) == job.size[0]


def test_shapes_have_the_inputs_of_the_thesis_or_of_the_defaults():
    network, rules = TrainingJob(NETWORK, THESIS, (), (2, 4, 5, 30)), TrainingJob(ANFIS, THESIS, (), (3, 6))
    shape = make_shape(network)
    assert (shape.units, shape.lags.forces, shape.lags.currents, shape.lags.speeds) == (30, 2, 4, 5)
    static = make_shape(rules)
    assert (static.currents, static.speeds, static.lags.forces) == (3, 6, 0)
    for job in (network, rules):
        ours = make_shape(replace(job, procedure=OURS))
        assert isinstance(ours.lags, Lags)
        assert getattr(ours, "units", 30) == 30


def test_missing_and_unstable_models_are_said(monkeypatch):
    monkeypatch.setattr(tables, "noise_floor", lambda name: 0.5)
    none = {(s, p, row): None for s in (POLYNOMIAL, ANFIS) for p in (THESIS, OURS) for row in TABLES[s].rows}
    polynomial, anfis = (format_table(s, none).splitlines() for s in (POLYNOMIAL, ANFIS))
    assert polynomial[2] == "| Sine 4 Hz | 7 | 2.34 | - | none stable | none stable | 0.50 |"
    assert anfis[-1] == "| Sine 16 Hz on the sine 4 Hz model | 4 x 4 | unstable | none stable | none stable | 0.50 |"
    assert percent(type("Evaluation", (), {"cost": inf})) == "unstable"


def test_a_model_is_trained_once_kept_judged_on_another_run_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(models, "code_digest", lambda: "fixed")
    monkeypatch.setitem(STARTS, POLYNOMIAL, 1)
    job = make_job(POLYNOMIAL, THESIS, TABLES[POLYNOMIAL].rows[0])
    first, again = (dict(train_jobs([job], 10.0, 1, tmp_path))[job] for _ in range(2))
    assert first.seconds == again.seconds, "the second time it comes from the store"
    assert 1 <= len(first.model.body.terms) <= 7
    evaluation = evaluate_outcome(first, run(load_named_experiment("thesis/sine_4hz", fresh=True)), clamped=False)
    assert 0.5 < evaluation.cost < 60.0
    assert evaluation.clamped_share == 0.0
    assert evaluate_outcome(TrainingOutcome(None, "why", 0.0), None) is None
    draw({(POLYNOMIAL, p, row): evaluation for p in (THESIS, OURS) for row in ROWS}, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
