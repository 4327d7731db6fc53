"""What the engine must say at its edges: nothing to explain, nothing to shrink, parameters without a trace."""

from __future__ import annotations

import numpy as np
import pytest
from engine_plant import NOISE_N, WEIGHTS, traced
from test_fit import Spring, Useless, fit_alone, fit_together, one, planted
from test_shrinkage import gaps, measured

from ces_gap.baseline.ceiling import learn_ceiling
from ces_gap.inference.explanations import estimate_parameters
from ces_gap.inference.verdict import VerdictFigures, calibration, probabilities


def test_a_gap_far_above_a_known_noise_is_a_gap_though_nothing_explains_it():
    figures = VerdictFigures(15.0, 0.0, -1.6, 1.0, 0.0, -1.6, 0, 0.0)
    made = probabilities(figures, {"friction": 1.0}, (), WEIGHTS)
    assert made.unknown > 0.5 > made.none


def test_without_a_gap_nothing_shrinks():
    blocks = measured(gaps(0.0, 1), 1)
    quieter = np.full(len(blocks.ticks), -1.0)  # less energy than the noise's: no gap
    shrink, (low, high) = blocks.shrink(quieter, -quieter)
    assert shrink == 0.0 and low == 0.0 == high
    assert blocks.shrink(quieter, quieter)[0] == 0.0


def test_a_parameter_without_a_trace_may_be_anything():
    evidence = planted(one(Spring(), 3000.0))
    fit = fit_together(evidence, [fit_alone(evidence, Spring()), fit_alone(evidence, Useless())])
    assert estimate_parameters(fit)[1][0].ci95 == (0.0, 1.0)


def test_the_learner_leaves_noise_alone():
    right = [traced(seed=s, seconds=10.0) for s in (1, 2)]
    for trace, told in zip(right, learn_ceiling(right, [t.simulated for t in right]).learnt.crossfitted, strict=True):
        assert np.sqrt(np.mean(told[trace.usable] ** 2)) < 0.02 * NOISE_N


def test_steps_of_the_force_are_not_noise():
    assert traced(seconds=20.0).noise_N == pytest.approx(NOISE_N, rel=0.15)


def test_weights_that_come_with_the_package_point_the_right_way():
    assert min(calibration().gap[1:]) >= 0.0 and min(calibration().unknown[1:]) >= 0.0
