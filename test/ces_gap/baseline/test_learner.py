"""The generic learner: planted weights are recovered, the penalty fits the data, predictions are cross-fitted."""

from __future__ import annotations

import numpy as np
import pytest
from gap_traces import ar_noise
from numpy.typing import NDArray

from ces_gap.baseline import learner
from ces_gap.baseline.learner import BLOCK_S, FOLDS, LearnerResult, learn

F = NDArray[np.float64]
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


def test_useless_features_hardly_degrade_cross_fitted_predictions() -> None:
    features, targets = make_data(useless=60)
    result = np.concatenate(fit(features, targets).crossfitted)
    truth = np.concatenate([x[:, :4] @ PLANTED for x in features])
    assert np.sqrt(np.mean((result - truth) ** 2)) < 1.5 * 8.0 * np.sqrt(64 * FOLDS / (FOLDS - 1) / len(truth))
