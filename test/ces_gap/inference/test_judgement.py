"""The odds of causes: more of a gap, less of an explanation, what a twin's error hides; which gap is none."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from engine_plant import NOISE_N, SIMULATION, WEIGHTS, traced
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_gap.baseline.learner import make_white_noise
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.inference.evidence import gather
from ces_gap.inference.findings import measure_gap, tolerance_N
from ces_gap.inference.judgement import OddsWeights, Probabilities, VerdictFigures, calibration, probabilities
from ces_gap.inference.search import EffectSearchResult

CLEAR = VerdictFigures(10.0, 30.0, 25.0, 0.02, 0.02, 0)

LEFT = {"friction": 0.02, "gas_spring": 0.5, "inertia": 0.9}


def odds(
    figures: VerdictFigures, left: dict[str, float] | None = None, composition: tuple[str, ...] = ("friction",)
) -> Probabilities:
    return probabilities(figures, LEFT if left is None else left, composition, WEIGHTS)


SHARE = st.floats(-2.0, 3.0)

FIGURES = st.builds(
    VerdictFigures,
    st.floats(-1.0, 1e6),
    st.floats(-50.0, 1e4),
    st.floats(-50.0, 1e4),
    SHARE,
    SHARE,
    st.integers(0, 5),
)


@given(FIGURES, st.lists(SHARE, min_size=1, max_size=6), st.sets(st.integers(0, 5)))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_probabilities_sum_to_one_and_none_is_negative(
    figures: VerdictFigures, left: list[float], inside: set[int]
) -> None:
    unexplained = {f"effect{k}": share for k, share in enumerate(left)}
    composition = tuple(name for k, name in enumerate(unexplained) if k in inside)
    result = odds(figures, unexplained, composition)
    every = [result.none, result.unknown, *result.effects.values()]
    assert min(every) >= 0.0
    assert sum(every) == pytest.approx(1.0)
    assert set(result.effects) == set(unexplained)


@pytest.mark.parametrize("figure", ["energy", "gain_z"])
def test_the_more_there_is_the_less_probable_is_no_gap(figure: str) -> None:
    none = [odds(replace(CLEAR, **{figure: value, "ceiling_z": 0.5})).none for value in (0.01, 0.1, 1.0, 10.0, 100.0)]
    assert none == sorted(none, reverse=True) and none[0] > none[-1]


@pytest.mark.parametrize("figure", ["unexplained", "learnable"])
def test_the_more_is_left_the_more_probable_is_something_unknown(figure: str) -> None:
    unknown = [odds(replace(CLEAR, **{figure: value})).unknown for value in (0.0, 0.02, 0.1, 0.4, 0.9)]
    assert unknown == sorted(unknown) and unknown[0] < unknown[-1]


def test_a_clear_cause_is_most_probable_and_a_marginal_one_is_not() -> None:
    clear = odds(CLEAR)
    assert clear.effects["friction"] > 0.5 > clear.none + clear.unknown
    marginal = odds(VerdictFigures(0.01, 0.5, 0.5, 1.0, 0.0, 0))
    assert marginal.none > 0.5
    strange = odds(replace(CLEAR, unexplained=0.8, learnable=0.7))
    assert strange.unknown > 0.5


@pytest.mark.parametrize("mode", ["references", "no_references", "predictions", "identified"])
def test_calibrated_weights_are_complete_and_finite(mode: str) -> None:
    weights = calibration(mode)
    assert isinstance(weights, OddsWeights)
    for field in fields(weights):
        assert np.isfinite(getattr(weights, field.name)).all(), field.name
    assert min(weights.gap[1:]) >= 0.0 and min(weights.unknown[1:]) >= 0.0
    assert 0.0 < weights.least_gap < 1.0 and 0.0 < weights.least_known < 1.0 and weights.sharpness > 0.0


def test_effects_that_leave_as_little_are_as_probable() -> None:
    tied = odds(CLEAR, {**LEFT, "gas_spring": 0.02})
    assert tied.effects["gas_spring"] == pytest.approx(tied.effects["friction"])


def test_a_gap_far_above_the_known_noise_is_a_gap_even_without_explanation() -> None:
    figures = VerdictFigures(15.0, 0.0, -1.6, 1.0, 0.0, 0)
    odds = probabilities(figures, {"friction": 1.0}, (), WEIGHTS)
    assert odds.unknown > 0.5 > odds.none


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
