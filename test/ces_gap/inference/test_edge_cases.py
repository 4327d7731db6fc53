"""Edge cases of the inference: nothing to explain, nothing to shrink, parameters without influence."""

from __future__ import annotations

import numpy as np
import pytest
from engine_plant import NOISE_N, WEIGHTS, traced
from example_effects import Spring
from fit_examples import Useless, one, planted
from shrinkage_examples import gaps, make_blocks

from ces_gap.baseline.learner import learn_ceiling
from ces_gap.inference.fit import estimate_parameters, fit_alone, fit_together
from ces_gap.inference.verdict import VerdictFigures, calibration, probabilities


def test_a_gap_far_above_the_known_noise_is_a_gap_even_without_explanation():
    figures = VerdictFigures(15.0, 0.0, -1.6, 1.0, 0.0, -1.6, 0, 0.0)
    odds = probabilities(figures, {"friction": 1.0}, (), WEIGHTS)
    assert odds.unknown > 0.5 > odds.none


def test_without_a_gap_nothing_shrinks():
    blocks = make_blocks(gaps(0.0, 1), 1)
    quieter = np.full(len(blocks.ticks), -1.0)  # less energy than the noise: no gap
    shrink, (low, high) = blocks.shrink(quieter, -quieter)
    assert shrink == 0.0 and low == 0.0 == high
    assert blocks.shrink(quieter, quieter)[0] == 0.0


def test_a_parameter_without_influence_has_its_whole_range_as_interval():
    evidence = planted(one(Spring(), 3000.0))
    fit = fit_together(evidence, [fit_alone(evidence, Spring()), fit_alone(evidence, Useless())])
    assert estimate_parameters(fit)[1][0].ci95 == (0.0, 1.0)


def test_the_learner_leaves_noise_alone():
    correct = [traced(seed=s, seconds=10.0) for s in (1, 2)]
    for trace, predicted in zip(
        correct, learn_ceiling(correct, [t.simulated for t in correct]).learnt.crossfitted, strict=True
    ):
        assert np.sqrt(np.mean(predicted[trace.usable] ** 2)) < 0.02 * NOISE_N


def test_steps_of_the_force_are_not_noise():
    assert traced(seconds=20.0).noise_N == pytest.approx(NOISE_N, rel=0.15)


def test_calibrated_weights_have_the_right_sign():
    assert min(calibration().gap[1:]) >= 0.0 and min(calibration().unknown[1:]) >= 0.0
