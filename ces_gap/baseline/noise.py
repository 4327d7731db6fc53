"""Autocorrelated noise on the grid of a trace: an autoregression that whitens it to unit variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

F = NDArray[np.float64]
B = NDArray[np.bool_]

ORDER = 6


@dataclass(frozen=True)
class NoiseModel:
    """`rms_N` of the noise, standard deviation `innovation_N` of the innovation, coefficients `ar` (p,)."""

    rms_N: float
    innovation_N: float
    ar: F

    def scale(self, factor: float) -> NoiseModel:
        """Return noise with the same spectrum, `factor` times as strong."""
        return NoiseModel(self.rms_N * factor, self.innovation_N * factor, self.ar)

    def whiten(self, values: F) -> F:
        """Return columns (n, …) whitened along the first axis; the first p rows are transient."""
        out = values / self.innovation_N
        for k, weight in enumerate(self.ar / self.innovation_N, 1):
            out[k:] -= weight * values[:-k]
        return np.asarray(out)

    def usable_after_whitening(self, usable: B) -> B:
        """Return the mask (n,) of the ticks whose whitened value depends on usable ticks only."""
        window = np.ones(len(self.ar) + 1)
        return np.asarray(np.convolve(~usable, window)[: len(usable)] < 0.5) & (np.arange(len(usable)) >= len(self.ar))


def make_white_noise(rms_N: float) -> NoiseModel:
    """Return white noise of RMS `rms_N`."""
    return NoiseModel(rms_N, rms_N, np.zeros(0))


def noise_of(residuals: Sequence[F], usable: Sequence[B], order: int = ORDER) -> NoiseModel:
    """Return the noise model of the usable parts of residuals [N] (Yule-Walker equations)."""
    lags = autocovariance(residuals, usable, order)
    lags[0] = max(lags[0] * (1.0 + 1e-6), 1e-12)
    ar = solve_toeplitz(lags[:-1], lags[1:])
    return NoiseModel(float(np.sqrt(lags[0])), float(np.sqrt(max(lags[0] - ar @ lags[1:], 1e-4 * lags[0]))), ar)


def autocovariance(values: Sequence[F], usable: Sequence[B], order: int) -> F:
    """Return the autocovariance (order + 1,) [N2] about zero of the usable parts of `values` [N]."""
    masked = [np.where(u, r, 0.0) for r, u in zip(values, usable, strict=True)]
    count = max(sum(int(u.sum()) for u in usable), 1)
    return np.array([sum(float(r[: len(r) - k] @ r[k:]) for r in masked) for k in range(order + 1)]) / count
