"""Candidate experiments: the rig can run them, and they stay within the range of the recordings."""

from __future__ import annotations

import numpy as np
import pytest
from example_effects import drive, trace_of

from ces_gap.experiment.candidates import Reach, generate_waveforms, list_candidate_experiments, reach_of
from ces_rig.experiments.virtual import parse_experiment

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
