"""Candidate experiments: the rig generates the same signals, and they stay within the range of the recordings."""

from __future__ import annotations

import numpy as np
import pytest
from example_effects import drive, trace_of

from ces_gap.experiment.candidates import (
    CURRENTS,
    STROKES,
    Reach,
    generate_waveforms,
    list_candidate_experiments,
    reach_of,
)
from ces_rig.experiments.virtual import parse_experiment
from ces_rig.sensors import GRID_S

REACHES = {
    "motorcycle": Reach(0.002, 0.025, 0.9, 90.0, 0.29, 0.7),
    "slow dyno": Reach(-0.01, 0.05, 0.12, 2.0, 0.3, 0.6),
    "shaker": Reach(0.0, 0.004, 0.4, 120.0, 0.3, 1.6),
    "little": Reach(0.0, 0.001, 0.01, 1.0, 0.2, 0.3),
}


@pytest.mark.parametrize("name", REACHES)
def test_the_rig_generates_the_same_signals_within_the_reach(name: str) -> None:
    reach, inside = REACHES[name], slice(600, -600)  # fading adds a little speed
    for recipe in list_candidate_experiments(reach):
        experiment = parse_experiment(recipe, recipe["name"])
        time = np.arange(round(experiment.settings.duration_s / GRID_S) + 1) * GRID_S
        stroke = experiment.stroke.samples(time, np.random.default_rng([recipe["seed"], 0]))
        level = experiment.current.samples(time, stroke, np.random.default_rng([recipe["seed"], 1]))
        seconds, position, current = generate_waveforms(recipe)
        np.testing.assert_allclose(seconds, time[::2], atol=1e-12)
        np.testing.assert_allclose(position, stroke[::2], atol=1e-9, err_msg=recipe["name"])
        np.testing.assert_allclose(current, level[::2], atol=1e-12, err_msg=recipe["name"])
        speed = np.gradient(position, seconds)
        assert 10.0 <= recipe["duration_s"] <= 40.0 and seconds[-1] == pytest.approx(recipe["duration_s"])
        assert np.abs(position - reach.centre_m).max() <= 1.01 * reach.amplitude_m, recipe["name"]
        assert np.abs(speed[inside]).max() <= 1.02 * reach.speed_m_s, recipe["name"]
        assert np.abs(np.gradient(speed, seconds)[inside]).max() <= 1.1 * reach.acceleration_m_s2, recipe["name"]
        assert reach.low_A - 1e-9 <= current.min() and current.max() <= reach.high_A + 1e-9


def test_the_candidates_use_every_kind_of_waveform() -> None:
    recipes = list_candidate_experiments(REACHES["motorcycle"])
    assert {r["stroke"]["kind"] for r in recipes} == set(STROKES)
    assert {r["current"]["kind"] for r in recipes} == set(CURRENTS)
    assert len({r["name"] for r in recipes}) == len(recipes)


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
