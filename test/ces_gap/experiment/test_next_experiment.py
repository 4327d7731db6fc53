"""The next experiment: it separates what the recordings could not, the rig can run it, and its prediction holds."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from example_effects import PLANT, SIMULATION, CurrentOffset, Friction, Rubbing, Scale, Spring, damper, drive, trace_of
from search_examples import FRICTION, SPRING, planted, run_search

from ces_data.arrays import F
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.baseline.twin_fit import fit_twin
from ces_gap.diagnosis import NextExperiment
from ces_gap.effects.effect import Effect, EffectParameter, Setting
from ces_gap.errors import GapError
from ces_gap.experiment.candidates import (
    Reach,
    generate_waveforms,
    list_candidate_experiments,
    reach_of,
)
from ces_gap.experiment.next_experiment import experiment_files, find_pairs, propose_experiment, simulate_experiment
from ces_gap.inference.judgement import AMBIGUOUS, Judgement, Probabilities
from ces_gap.trace import Trace, TraceInputs
from ces_identify.simulations.simulation import FunctionSimulation
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically
from ces_rig.experiments.virtual import load_experiment, parse_experiment

NOISE_N = 8.0
STILL, STEPS = drive("constant"), drive("steps")
RECIPES = [{**r, "duration_s": 5.0} for r in list_candidate_experiments(reach_of([STEPS]))]  # shorter than usual
PAIR = (
    Setting(CurrentOffset(), (0.03,)),
    Setting(Scale(), (1.06,)),
)  # indistinguishable at a constant current of 0.5 A


@pytest.fixture(scope="module")
def proposed() -> NextExperiment:
    experiment = propose_experiment(PLANT, [STILL], [PAIR], NOISE_N, recipes=RECIPES)
    assert experiment is not None
    return experiment


def test_another_current_separates_effects_alike_at_constant_current(proposed: NextExperiment) -> None:
    assert np.ptp(proposed.current_A) > 0.1 or abs(proposed.current_A[0] - 0.5) > 0.1
    assert proposed.separates == ("current_offset", "scale")
    assert proposed.purpose.startswith("distinguishes current offset from scale: expected difference ")


def test_the_promised_difference_is_what_a_refit_leaves() -> None:
    proposed = propose_experiment(PLANT, [STEPS], [PAIR], NOISE_N, recipes=RECIPES)
    assert proposed is not None
    trace = simulate_experiment(PLANT.simulation, proposed.recipe)
    keep = trace.usable
    shape = damper(proposed.time_s, proposed.position_m, np.ones(len(proposed.time_s)))[::2][: len(keep)]
    current = proposed.current_A[::2][: len(keep)]
    by_offset, by_scale = (0.03 * shape)[keep], (0.06 * shape * current)[keep]
    residuals = [_left(by_offset, by_scale), _left(by_scale, by_offset)]
    assert proposed.distance_N == pytest.approx(min(residuals), rel=0.05)
    assert f"{proposed.distance_N:.2g} N RMS" in proposed.purpose


def _left(a: F, b: F) -> float:
    """Return the RMS of `a` less the multiple of `b` that comes nearest but for a constant."""
    a0, b0 = a - a.mean(), b - b.mean()
    return float(np.sqrt(np.mean((a - (a0 @ b0) / (b0 @ b0) * b) ** 2)))


def test_no_experiment_is_proposed_whose_difference_is_below_the_noise() -> None:
    same = (Setting(Friction(), (40.0, 0.05)), Setting(Rubbing(), (800.0, 0.05)))
    with pytest.raises(GapError, match=r"none of the 3 .* would distinguish friction from rubbing: .* × the noise"):
        propose_experiment(PLANT, [STEPS], [same], NOISE_N, recipes=RECIPES[:3])
    clear = propose_experiment(PLANT, [STEPS], [PAIR], NOISE_N, recipes=RECIPES)
    assert clear is not None and clear.distance_N > NOISE_N
    with pytest.raises(GapError, match="largest expected difference"):
        propose_experiment(PLANT, [STEPS], [PAIR], 1.1 * clear.distance_N, recipes=RECIPES)


@pytest.mark.parametrize(
    ("composition", "alternatives", "ties", "pairs"),
    [
        (("friction",), ("spring",), (), [("friction", "spring")]),
        ((), ("spring",), (), [("spring", "friction")]),  # what was fitted enlarged the held-out gap
        ((), ("spring", "offset"), (), [("spring", "offset")]),
        (("simulation_timing", "friction"), ("spring",), (), [("friction", "spring")]),
        (("friction",), (), (("friction",),), [("spring", "friction")]),  # a tie of one
        (("parameters",), ("parameters",), (("parameters", "friction"),), [("spring", "friction")]),
    ],
)
def test_every_verdict_has_pairs_of_two_effects_that_can_be_simulated(
    composition: tuple[str, ...],
    alternatives: tuple[str, ...],
    ties: tuple[tuple[str, ...], ...],
    pairs: list[tuple[str, str]],
) -> None:
    result = run_search(planted(SPRING, FRICTION))
    judgement = Judgement(AMBIGUOUS, Probabilities(0.0, 0.0, {}), "", "", alternatives, ties)
    names = [(a.name, b.name) for a, b in find_pairs(result, composition, judgement)]
    assert names == pairs and [f.names[0] for f in result.alone][:2] == ["spring", "friction"]


def test_without_pairs_there_is_no_experiment() -> None:
    assert propose_experiment(PLANT, [STEPS], [], NOISE_N) is None


def test_an_experiment_the_simulation_refuses_is_left_out() -> None:
    def careful(time_s: F, position_m: F, current_A: F) -> F:
        if np.ptp(current_A) > 0.01:
            raise CesError("the current must not change")
        return damper(time_s, position_m, current_A)

    plant = Plant(DirectSimulator(FunctionSimulation("careful", careful)))
    pair = (Setting(Spring(), (8000.0,)), Setting(Scale(), (1.2,)))
    proposed = propose_experiment(plant, [STEPS], [pair], NOISE_N, recipes=RECIPES)
    assert proposed is not None and np.ptp(proposed.current_A) == 0.0

    def never(time_s: F, position_m: F, current_A: F) -> F:
        raise CesError("no")

    refusing = Plant(DirectSimulator(FunctionSimulation("never", never)))
    with pytest.raises(GapError, match="refuses all"):
        propose_experiment(refusing, [STEPS], [pair], NOISE_N, recipes=RECIPES)


class Yielding(Effect):
    """The position gives way to the force, and jumps with it."""

    name, form, reruns = "yielding", "linear", True
    parameters = (EffectParameter("compliance_m_N", 0.0, 2e-5, (1e-7,), "compliance", magnitude=True),)

    def drive(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> TraceInputs:
        return inputs.with_position(inputs.position - values[0] * force, trace.rate_Hz)


def test_an_experiment_is_left_out_if_the_simulation_refuses_what_an_effect_makes_of_it() -> None:
    def gated(time_s: F, position_m: F, current_A: F) -> F:
        if np.abs(np.diff(position_m, n=2)).max() > 1e-4:
            raise CesError("the position jumps")
        return damper(time_s, position_m, current_A)

    plant = Plant(DirectSimulator(FunctionSimulation("gated", gated)))
    pair = (Setting(Scale(), (1.3,)), Setting(Yielding(), (6e-8,)))
    jumping = [r for r in RECIPES if r["name"] in ("current_prbs", "current_steps")]
    with pytest.raises(GapError, match="refuses all 2 candidate experiments"):
        propose_experiment(plant, [STEPS], [pair], 1.0, recipes=jumping)
    proposed = propose_experiment(plant, [STEPS], [pair], 1.0, recipes=RECIPES)
    assert proposed is not None and proposed.name not in ("current_prbs", "current_steps")


@pytest.mark.slow
def test_a_twin_of_recorded_predictions_proposes_too() -> None:
    twin = fit_twin([STEPS])
    assert twin is not None
    plant = Plant(twin)
    proposed = propose_experiment(plant, [STEPS], [PAIR], NOISE_N, recipes=RECIPES)
    assert proposed is not None and proposed.distance_N > 1.0
    trace = simulate_experiment(twin, proposed.recipe)
    true = simulate_experiment(DirectSimulator(SIMULATION), proposed.recipe).simulated
    assert np.corrcoef(trace.simulated, true)[0, 1] > 0.9


def test_no_time_still_gives_an_experiment() -> None:
    recipes = [r for r in RECIPES if r["name"] in ("current_steps", "current_prbs")]
    proposed = propose_experiment(PLANT, [STEPS], [PAIR], NOISE_N, recipes=recipes, budget_s=0.0)
    assert proposed is not None and proposed.name == recipes[0]["name"]


def test_the_files_are_what_the_rig_and_a_dyno_read(proposed: NextExperiment, tmp_path: Path) -> None:
    described, table = (tmp_path / f"next_experiment.{kind}" for kind in ("yaml", "csv"))
    write_all_atomically({tmp_path / name: text for name, text in experiment_files(proposed).items()})
    experiment = load_experiment(described)
    assert experiment.settings.name == proposed.name
    assert yaml.safe_load(described.read_text(encoding="utf-8")) == proposed.recipe
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time_s", "position_m", "current_A"]
    values = np.array([[float(v) for v in row.values()] for row in rows]).T
    np.testing.assert_allclose(values[0], proposed.time_s, atol=1e-9)
    np.testing.assert_allclose(values[1], proposed.position_m, atol=1e-7)
    np.testing.assert_allclose(values[2], proposed.current_A, atol=1e-4)


REACHES = {
    "motorcycle": Reach(0.002, 0.025, 0.9, 90.0, 0.29, 0.7),
    "slow dyno": Reach(-0.01, 0.05, 0.12, 2.0, 0.3, 0.6),
    "shaker": Reach(0.0, 0.004, 0.4, 120.0, 0.3, 1.6),
    "little": Reach(0.0, 0.001, 0.01, 1.0, 0.2, 0.3),
}


@pytest.mark.parametrize("name", REACHES)
def test_the_rig_runs_them_within_the_reach(name: str) -> None:
    reach, inside = REACHES[name], slice(600, -600)  # fading adds a little speed
    for recipe in list_candidate_experiments(reach):
        assert parse_experiment(recipe, recipe["name"]).settings.duration_s == recipe["duration_s"]
        seconds, position, current = generate_waveforms(recipe)
        speed = np.gradient(position, seconds)
        assert 10.0 <= recipe["duration_s"] <= 40.0 and seconds[-1] == pytest.approx(recipe["duration_s"])
        assert np.abs(position - reach.centre_m).max() <= 1.01 * reach.amplitude_m, recipe["name"]
        assert np.abs(speed[inside]).max() <= 1.02 * reach.speed_m_s, recipe["name"]
        assert np.abs(np.gradient(speed, seconds)[inside]).max() <= 1.1 * reach.acceleration_m_s2, recipe["name"]
        assert reach.low_A - 1e-9 <= current.min() and current.max() <= reach.high_A + 1e-9


def test_the_reach_is_that_of_the_recordings_and_a_little_more() -> None:
    reach = reach_of([drive()])
    assert reach.centre_m == pytest.approx(0.0, abs=1e-3)
    assert 0.021 < reach.amplitude_m < 0.026 and 0.2 < reach.speed_m_s < 0.31
    assert (reach.low_A, reach.high_A) == (0.3, 0.7)
    constant = reach_of([drive("constant")])
    assert (constant.low_A, constant.high_A) == (0.375, 0.625)  # varied a little


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_a_fixed_current_is_not_commanded(level: float) -> None:
    time = np.arange(2000) / 500.0
    trace = trace_of(0.01 * np.sin(9.0 * time), np.full_like(time, level), constants=True)
    reach = reach_of([trace])
    assert reach.low_A == reach.high_A == level
    recipes = list_candidate_experiments(reach)
    assert recipes and {r["current"]["kind"] for r in recipes} == {"constant"}


def test_recordings_almost_without_motion_give_experiments_that_the_rig_can_run() -> None:
    time = np.arange(2000) / 500.0
    for recipe in list_candidate_experiments(reach_of([trace_of(np.zeros_like(time), np.full_like(time, 0.5))])):
        parse_experiment(recipe, recipe["name"])
        assert np.isfinite(generate_waveforms(recipe)[1]).all()
