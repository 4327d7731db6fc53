"""The generic learner: noise, the dictionary of features, planted weights, correction and ceiling."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from engine_plant import NOISE_N, F, damper, traced
from gap_traces import ar_noise
from numpy.typing import NDArray

from ces_gap.baseline import learner
from ces_gap.baseline.learner import (
    BLOCK_S,
    FOLDS,
    Dictionary,
    LearnedCorrection,
    LearnerResult,
    Scales,
    learn,
    learn_ceiling,
    learn_correction,
    noise_of,
)
from ces_gap.errors import GapError
from ces_gap.trace import Trace, TraceInputs
from ces_observer.records import read_record, write_record

EVERYWHERE = np.ones(40000, bool)


def simulated(pole: float, seed: int = 1, rms_N: float = 8.0) -> F:
    return ar_noise(len(EVERYWHERE), rms_N, pole, np.random.default_rng(seed))


def autocorrelation(values: F, lag: int) -> float:
    return float(values[:-lag] @ values[lag:] / (values @ values))


@pytest.mark.parametrize("pole", [0.0, 0.7, -0.5, 0.97])
def test_simulated_noise_is_identified_and_whitened(pole: float) -> None:
    values = simulated(pole)
    noise = noise_of([values], [EVERYWHERE])
    assert noise.ar[0] == pytest.approx(pole, abs=0.03)
    np.testing.assert_allclose(noise.ar[1:], 0.0, atol=0.03)
    assert noise.rms_N == pytest.approx(8.0, rel=0.1)
    assert noise.innovation_N == pytest.approx(8.0 * np.sqrt(1.0 - pole**2), rel=0.02)
    flat = noise.whiten(values)[len(noise.ar) :]
    assert flat.std() == pytest.approx(1.0, abs=0.02)
    assert max(abs(autocorrelation(flat, lag)) for lag in range(1, 20)) < 4.0 / np.sqrt(len(flat))


def test_a_whitened_value_is_usable_if_it_depends_on_usable_ticks_only() -> None:
    noise = noise_of([simulated(0.7)], [EVERYWHERE], order=3)
    usable = np.ones(20, bool)
    usable[[10]] = False
    assert np.flatnonzero(~noise.usable_after_whitening(usable)).tolist() == [0, 1, 2, 10, 11, 12, 13]
    values, spoiled = np.arange(20.0), np.where(usable, np.arange(20.0), 1e6)
    clean = noise.usable_after_whitening(usable)
    np.testing.assert_array_equal(noise.whiten(values)[clean], noise.whiten(spoiled)[clean])


def test_zero_residuals_give_finite_noise() -> None:
    noise = noise_of([np.zeros(500)], [np.ones(500, bool)])
    assert np.isfinite(noise.whiten(np.ones(500))).all()
    assert noise.rms_N < 1e-3


@cache
def short_trace(constant_A: float | None) -> Trace:
    return traced(seconds=3.0, constant_A=constant_A)


def dictionary(trace: Trace, by_force: bool, by_time: bool) -> Dictionary:
    return Dictionary(Scales.of([trace], [trace.simulated]), by_force, by_time)


@pytest.mark.parametrize("by_time", [True, False])
@pytest.mark.parametrize("by_force", [True, False])
@pytest.mark.parametrize("constant_A", [None, 0.6])
def test_a_dictionary_fills_every_column_predicts_their_weighted_sum_and_survives_json(
    constant_A: float | None, by_force: bool, by_time: bool
) -> None:
    trace = short_trace(constant_A)
    learner = dictionary(trace, by_force, by_time)
    features = learner.features(trace, trace.inputs, trace.simulated)
    assert features.shape == (len(trace), learner.size + (5 if by_time else 0))
    assert np.isfinite(features).all()
    assert (np.abs(features[trace.usable]).max(axis=0) > 0.0).all()  # a column beyond those filled would stay zero
    assert np.sqrt(np.mean(features**2, axis=0)).max() < 10.0
    weights = np.random.default_rng(1).standard_normal(features.shape[1])
    predicted = learner.predict(trace, trace.inputs, trace.simulated, weights)
    np.testing.assert_allclose(predicted, features @ weights, rtol=1e-9, atol=1e-9)
    assert read_record(Dictionary, json.loads(json.dumps(write_record(learner))), "", GapError) == learner


@pytest.mark.parametrize(
    ("varies", "by_force", "expected"),
    [
        (True, True, (-0.618798080188, -3.69022962754, 4.75785390329, 0.133596070908, 0.479514970626)),
        (True, False, (-0.864656333924, -2.58877215579, 2.59886268918, 0.692690243838, 2.34209594431)),
        (False, True, (0.392955105046, -2.0016450388, 0.251271304355, -1.91066488945, -1.42068677004)),
        (False, False, (-0.449856237579, -1.37583002325, -0.857777425898, -2.88169114614, -0.205045132329)),
    ],
)
def test_weights_that_are_stored_in_files_weigh_the_same_features_as_ever(
    varies: bool, by_force: bool, expected: tuple[float, ...]
) -> None:
    time_s = np.arange(400) / 250.0
    position = 0.01 * np.sin(9.0 * time_s) + 0.004 * np.sin(31.0 * time_s)
    current, force = 0.6 + 0.3 * np.sin(3.0 * time_s), 500.0 * np.sin(11.0 * time_s + 1.0)
    inputs = TraceInputs(position, np.gradient(position, time_s), current)
    trace = replace(short_trace(None), rate_Hz=250.0, time_s=time_s)
    scales = Scales((0.0, 0.01), 0.1, (0.6, 0.2), (0.0, 400.0), varies)
    learner = Dictionary(scales, by_force)
    weights = np.sin(1.0 + np.arange(learner.size)) ** 3
    assert learner.predict(trace, inputs, force, weights)[[0, 50, 133, 250, 399]] == pytest.approx(expected, rel=1e-9)


def test_extreme_currents_are_clipped() -> None:
    trace = short_trace(None)
    learner = dictionary(trace, True, False)
    far = trace.inputs.with_current(np.full(len(trace), 100.0))
    further = trace.inputs.with_current(np.full(len(trace), 1e4))
    np.testing.assert_array_equal(
        learner.features(trace, far, trace.simulated), learner.features(trace, further, trace.simulated)
    )


def test_a_current_that_hardly_changes_counts_as_constant() -> None:
    assert Scales.of([short_trace(None)], [short_trace(None).simulated]).varies
    still = short_trace(0.6)
    assert not Scales.of([still], [still.simulated]).varies
    ripple = replace(still, inputs=still.inputs.with_current(0.6 + 0.006 * np.sin(20.0 * still.time_s)))
    assert not Scales.of([ripple], [still.simulated]).varies


RATE_HZ = 200.0

BLOCK = round(BLOCK_S * RATE_HZ)

LENGTHS = (13 * BLOCK, 9 * BLOCK + 37)

PLANTED = np.array([30.0, -12.0, 5.0, 0.0])


def smooth(shape: tuple[int, int], rng: np.random.Generator) -> F:
    raw = rng.standard_normal((shape[0] + 4, shape[1]))
    return sum(raw[k : k + shape[0]] for k in range(5)) / np.sqrt(5.0)


def make_data(noise_N: float = 8.0, pole: float = 0.0, seed: int = 1, useless: int = 0) -> tuple[list[F], list[F]]:
    """Features (n, 4 + useless) of two traces, and targets by the planted weights in noise."""
    rng = np.random.default_rng(seed)
    features = [smooth((n, 4 + useless), rng) for n in LENGTHS]
    targets = [x[:, :4] @ PLANTED + ar_noise(len(x), noise_N, pole, rng) for x in features]
    return features, targets


def everywhere() -> list[NDArray[np.bool_]]:
    return [np.ones(n, bool) for n in LENGTHS]


def fit(features: list[F], targets: list[F], passes: int = 2) -> LearnerResult:
    return learn(features, targets, everywhere(), RATE_HZ, passes)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_planted_weights_are_recovered_within_their_covariance(pole: float) -> None:
    learnt = fit(*make_data(8.0, pole))
    away = learnt.weights - PLANTED
    assert away @ np.linalg.solve(learnt.covariance, away) < 25.0  # chi-squared with 4 degrees of freedom
    assert learnt.noise.rms_N == pytest.approx(8.0, rel=0.15)
    assert learnt.noise.innovation_N == pytest.approx(8.0 * np.sqrt(1.0 - pole**2), rel=0.05)


@pytest.mark.slow
def test_the_covariance_matches_the_scatter_over_repetitions() -> None:
    features, _ = make_data()
    rng = np.random.default_rng(5)
    fits = [fit(features, [x @ PLANTED + ar_noise(len(x), 8.0, 0.8, rng) for x in features]) for _ in range(40)]
    scatter = np.std([f.weights for f in fits], axis=0)
    result = np.sqrt(np.mean([np.diag(f.covariance) for f in fits], axis=0))
    np.testing.assert_allclose(result, scatter, rtol=0.35)


def missed(learnt: LearnerResult, targets: list[F]) -> float:
    """Mean square error of the cross-fitted predictions."""
    return float(np.mean((np.concatenate(targets) - np.concatenate(learnt.crossfitted)) ** 2))


@pytest.mark.parametrize("noise_N", [1.0, 300.0])
def test_the_penalty_minimises_the_cross_fitted_error(noise_N: float, monkeypatch: pytest.MonkeyPatch) -> None:
    features, targets = make_data(noise_N, useless=60)
    chosen = missed(fit(features, targets, passes=1), targets)
    errors = []
    for penalty in learner.PENALTIES:
        monkeypatch.setattr(learner, "PENALTIES", np.array([penalty]))
        errors.append(missed(fit(features, targets, passes=1), targets))
    assert chosen == pytest.approx(min(errors), rel=1e-9)
    assert (np.argmin(errors) > len(errors) // 2) == (noise_N > 100.0)  # more noise, more penalty


def fold_of(length: int, first: int) -> NDArray[np.int64]:
    """The fold of each block of a second, numbered through all traces."""
    return (first + np.arange(length) // BLOCK) % FOLDS


def test_predictions_do_not_depend_on_their_own_fold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learner, "PENALTIES", np.array([1e-2]))  # the one thing that is chosen on all folds
    features, targets = make_data(useless=20)
    folds = [fold_of(LENGTHS[0], 0), fold_of(LENGTHS[1], 13)]
    plain = fit(features, targets, passes=1)
    for spoiled_fold in range(FOLDS):
        spoiled = [np.where(f == spoiled_fold, 1e4, y) for y, f in zip(targets, folds, strict=True)]
        result = fit(features, spoiled, passes=1)
        for before, after, fold in zip(plain.crossfitted, result.crossfitted, folds, strict=True):
            np.testing.assert_allclose(after[fold == spoiled_fold], before[fold == spoiled_fold], atol=1e-9)
            assert (np.abs(after - before)[fold != spoiled_fold] > 1.0).mean() > 0.9


def test_unusable_ticks_do_not_affect_the_fit() -> None:
    features, targets = make_data()
    usable = [np.arange(n) % 700 > 60 for n in LENGTHS]
    spoiled = [np.where(u, y, 1e6) for y, u in zip(targets, usable, strict=True)]
    plain, result = (learn(features, y, usable, RATE_HZ) for y in (targets, spoiled))
    np.testing.assert_allclose(result.weights, plain.weights, rtol=1e-12)
    assert result.noise.rms_N == pytest.approx(8.0, rel=0.05)


def wrong(time_s: F, position_m: F, current_A: F) -> F:
    """A real damper of which the simulation is a rough model."""
    speed = np.gradient(position_m, time_s)
    return np.asarray(1.06 * damper(time_s, position_m, current_A) + 70.0 * np.tanh(speed / 0.1) + 40.0 * speed)


def truth(trace: Trace) -> F:
    return wrong(trace.time_s, trace.inputs.position, trace.inputs.current)


def rms(values: F, trace: Trace) -> float:
    return float(np.sqrt(np.mean(values[trace.usable] ** 2)))


def references() -> list[Trace]:
    return [traced(wrong, seed=s, seconds=10.0) for s in (1, 2, 3)]


def unseen() -> Trace:
    return traced(wrong, seed=9)


@cache
def taught() -> tuple[LearnedCorrection, LearnerResult]:
    return learn_correction(references())


def test_references_teach_the_baseline_error() -> None:
    trace = unseen()
    own = truth(trace) - trace.simulated
    predicted = taught()[0].force(trace, trace.inputs, trace.simulated)
    assert rms(own, trace) > 5.0 * NOISE_N
    assert rms(own - predicted, trace) < 0.5 * NOISE_N
    assert taught()[1].noise.rms_N == pytest.approx(NOISE_N, rel=0.1)
    for trace, predicted in zip(references(), taught()[1].crossfitted, strict=True):
        assert rms(trace.force - trace.simulated - predicted, trace) == pytest.approx(NOISE_N, rel=0.1)


def test_the_correction_of_a_correct_simulation_is_nearly_zero() -> None:
    correction, _ = learn_correction([traced(seed=s) for s in (1, 2)])
    trace = traced(seed=9)
    assert rms(correction.force(trace, trace.inputs, trace.simulated), trace) < 0.3 * NOISE_N


def test_the_ceiling_explains_a_drift_with_time() -> None:
    rng = np.random.default_rng(1)
    fading = [
        replace(t, force=t.simulated * (1.0 - 0.01 * t.time_s) + NOISE_N * rng.standard_normal(len(t)))
        for t in references()
    ]
    taught = learn_ceiling(fading, [t.simulated for t in fading]).learnt
    for trace, predicted in zip(fading, taught.crossfitted, strict=True):
        gap = -0.01 * trace.time_s * trace.simulated
        assert rms(gap - predicted, trace) < 0.3 * rms(gap, trace)


def test_the_ceiling_explains_hardly_any_noise() -> None:
    right = [traced(seed=s, seconds=10.0) for s in (1, 2)]
    taught = learn_ceiling(right, [t.simulated for t in right]).learnt
    for trace, predicted in zip(right, taught.crossfitted, strict=True):
        assert rms(predicted, trace) < 0.02 * NOISE_N
