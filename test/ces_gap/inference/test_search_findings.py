"""What the search found, as numbers: the default tolerance, and noise from the measurement alone."""

from __future__ import annotations

from dataclasses import replace

import pytest
from engine_plant import NOISE_N, SIMULATION, traced

from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.inference.evidence import gather
from ces_gap.inference.findings import measure_gap, tolerance_N
from ces_gap.inference.search import EffectSearchResult


def test_the_default_tolerance_is_small_beside_force_and_noise() -> None:
    assert tolerance_N(8.0, 300.0, None) == pytest.approx(3.0)
    assert tolerance_N(8.0, 5000.0, None) == pytest.approx(16.0)
    assert tolerance_N(8.0, 5000.0, 0.02) == pytest.approx(100.0)


def test_noise_that_no_source_limits_is_a_guess_and_never_what_a_learner_leaves() -> None:
    trace = replace(traced(), noise_N=0.25 * NOISE_N)
    traces = [trace, replace(trace, measured_noise=replace(trace.measured_noise, known=False))]
    evidence = gather(traces, Plant(DirectSimulator(SIMULATION)), make_white_noise(NOISE_N))
    residual = evidence.residual(evidence.alone)
    size = measure_gap(EffectSearchResult(residual, (), None, 1.0, evidence))
    assert size.noise_N == pytest.approx(0.25 * NOISE_N, rel=0.01) and not size.noise_known
    assert size.gap_N == size.timed_N == pytest.approx(NOISE_N, rel=0.1)
