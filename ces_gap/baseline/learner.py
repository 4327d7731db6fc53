"""Ridge regression with autocorrelated noise; cross-validation over blocks chooses the penalty.

It learns the baseline error, the surrogate of recorded predictions and the ceiling.
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

PENALTIES = 10.0 ** np.arange(-7.0, 3.5, 0.75)  # over the mean square of a feature
BLOCK_S = 1.0  # [s] length of a block
FOLDS = 5


@dataclass(frozen=True)
class LearnerResult:
    """Weights (q,), their posterior covariance (q, q), the noise, and cross-fitted predictions [N] of each trace."""

    weights: F
    covariance: F
    noise: NoiseModel
    crossfitted: tuple[F, ...]


def learn(
    features: Sequence[F], targets: Sequence[F], usable: Sequence[B], rate_Hz: float, passes: int = 2
) -> LearnerResult:
    """Fit `targets` [N] (n,) by `features` (n, q) on the usable ticks of each trace.

    Each pass whitens by the autoregression of the cross-fitted residuals of the pass before. The folds are therefore
    not fully independent: the coefficients of the noise, and the penalty, come from all of them.
    """
    folds = _folds(features, rate_Hz)
    noise = make_white_noise(1.0)
    for _ in range(passes):
        gram, moment, penalty = _normal_equations(features, targets, usable, folds, noise)
        by_fold = [_solve(gram.sum(0) - gram[k], moment.sum(0) - moment[k], penalty) for k in range(len(gram))]
        crossfitted = tuple(
            np.einsum("nq,nq->n", x, np.stack(by_fold)[f]) for x, f in zip(features, folds, strict=True)
        )
        residuals = [y - p for y, p in zip(targets, crossfitted, strict=True)]
        noise = noise_of(residuals, usable)
    gram, moment, penalty = _normal_equations(features, targets, usable, folds, noise)
    total = gram.sum(0) + penalty * np.eye(gram.shape[1])
    factor = cho_factor(total)
    return LearnerResult(cho_solve(factor, moment.sum(0)), cho_solve(factor, np.eye(len(total))), noise, crossfitted)


def _folds(features: Sequence[F], rate_Hz: float) -> list[NDArray[np.int64]]:
    """Return the fold of every tick (n,) of each trace; blocks are numbered through all traces."""
    length, first, folds = max(1, round(BLOCK_S * rate_Hz)), 0, []
    for x in features:
        block = first + np.arange(len(x)) // length
        folds.append((block % FOLDS).astype(np.int64))
        first = int(block[-1]) + 1
    return folds


def _normal_equations(
    features: Sequence[F],
    targets: Sequence[F],
    usable: Sequence[B],
    folds: Sequence[NDArray[np.int64]],
    noise: NoiseModel,
) -> tuple[F, F, float]:
    """Return Gram matrix (k, q, q) and moments (k, q) of the whitened rows of each of k folds, and the best penalty."""
    keep = [noise.usable_after_whitening(u) for u in usable]
    x = np.concatenate([noise.whiten(v)[k] for v, k in zip(features, keep, strict=True)])
    y = np.concatenate([noise.whiten(v)[k] for v, k in zip(targets, keep, strict=True)])
    fold = np.concatenate([v[k] for v, k in zip(folds, keep, strict=True)])
    parts = [fold == k for k in range(FOLDS)]
    gram, moment = np.stack([x[p].T @ x[p] for p in parts]), np.stack([x[p].T @ y[p] for p in parts])
    return gram, moment, _choose_penalty(gram, moment, [float(y[p] @ y[p]) for p in parts])


def _choose_penalty(gram: F, moment: F, whole: Sequence[float]) -> float:
    """Return the penalty with the smallest squared error on the folds left out; `whole` is each fold's energy."""
    scale = max(float(np.trace(gram.sum(0))) / gram.shape[1], 1e-12)
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
