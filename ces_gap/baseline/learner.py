"""Ridge regression on the dictionary, its penalty chosen by cross-validation over blocks, noise autocorrelated.

The same learner serves the baseline's own error, the surrogate of recorded predictions and the ceiling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ces_gap.baseline.noise import NoiseModel, make_white_noise, noise_of

F = NDArray[np.float64]
B = NDArray[np.bool_]

PENALTIES = 10.0 ** np.arange(-7.0, 3.5, 0.75)  # over the mean square of a feature: from next to none to nothing learnt
BLOCK_S = 1.0  # [s] of a block that stays whole
FOLDS = 5


@dataclass(frozen=True)
class LearnerResult:
    """Weights (q,), their posterior covariance (q, q), the noise, and cross-fitted predictions [N] of each trace."""

    weights: F
    covariance: F
    noise: NoiseModel
    crossfitted: tuple[F, ...]


@dataclass(frozen=True)
class _Rows:
    """Whitened features (n, q), targets (n,) and the fold of each row."""

    features: F
    target: F
    fold: NDArray[np.int64]


def learn(
    features: Sequence[F], targets: Sequence[F], usable: Sequence[B], rate_Hz: float, passes: int = 2
) -> LearnerResult:
    """Return what ridge regression learns of `targets` [N] (n,) from `features` (n, q) on the usable ticks of traces.

    Each pass whitens by the autoregression of the cross-fitted residuals of the pass before, so that after the first a
    fold is not quite unseen: the noise's six coefficients, and the penalty, know all folds.
    """
    folds = _folds(features, rate_Hz)
    noise = make_white_noise(1.0)
    for _ in range(passes):
        rows = _rows(features, targets, usable, folds, noise)
        gram, moment = _by_fold(rows)
        penalty = _penalty(rows, gram, moment)
        by_fold = [_solve(gram.sum(0) - gram[k], moment.sum(0) - moment[k], penalty) for k in range(len(gram))]
        crossfitted = tuple(
            np.einsum("nq,nq->n", x, np.stack(by_fold)[f]) for x, f in zip(features, folds, strict=True)
        )
        residuals = [y - p for y, p in zip(targets, crossfitted, strict=True)]
        noise = noise_of(residuals, usable)
    rows = _rows(features, targets, usable, folds, noise)
    gram, moment = _by_fold(rows)
    penalty = _penalty(rows, gram, moment)
    total = gram.sum(0) + penalty * np.eye(gram.shape[1])
    factor = cho_factor(total)
    return LearnerResult(cho_solve(factor, moment.sum(0)), cho_solve(factor, np.eye(len(total))), noise, crossfitted)


def _folds(features: Sequence[F], rate_Hz: float) -> list[NDArray[np.int64]]:
    """Return the fold of every tick: blocks in turn, on through all traces."""
    length, first, folds = max(1, round(BLOCK_S * rate_Hz)), 0, []
    for x in features:
        block = first + np.arange(len(x)) // length
        folds.append((block % FOLDS).astype(np.int64))
        first = int(block[-1]) + 1
    return folds


def _rows(
    features: Sequence[F],
    targets: Sequence[F],
    usable: Sequence[B],
    folds: Sequence[NDArray[np.int64]],
    noise: NoiseModel,
) -> _Rows:
    keep = [noise.usable_after_whitening(u) for u in usable]
    return _Rows(
        np.concatenate([noise.whiten(x)[k] for x, k in zip(features, keep, strict=True)]),
        np.concatenate([noise.whiten(y)[k] for y, k in zip(targets, keep, strict=True)]),
        np.concatenate([f[k] for f, k in zip(folds, keep, strict=True)]),
    )


def _by_fold(rows: _Rows) -> tuple[F, F]:
    parts = [rows.fold == k for k in range(FOLDS)]
    gram = np.stack([rows.features[p].T @ rows.features[p] for p in parts])
    return gram, np.stack([rows.features[p].T @ rows.target[p] for p in parts])


def _penalty(rows: _Rows, gram: F, moment: F) -> float:
    """Return the penalty with the least squared error on the folds left out."""
    scale = max(float(np.trace(gram.sum(0))) / gram.shape[1], 1e-12)
    whole = [float(rows.target[rows.fold == k] @ rows.target[rows.fold == k]) for k in range(FOLDS)]
    costs = []
    for penalty in PENALTIES * scale:
        cost = 0.0
        for k in range(FOLDS):
            w = _solve(gram.sum(0) - gram[k], moment.sum(0) - moment[k], penalty)
            cost += whole[k] - 2.0 * float(w @ moment[k]) + float(w @ gram[k] @ w)
        costs.append(cost)
    return float(PENALTIES[int(np.argmin(costs))] * scale)


def _solve(gram: F, moment: F, penalty: float) -> F:
    return np.asarray(cho_solve(cho_factor(gram + penalty * np.eye(len(gram))), moment))
