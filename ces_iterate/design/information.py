"""What the recordings so far say about every state, and how much a candidate would add.

Bayesian linear regression on the features: with prior covariance I and error variance s², rows Phi of a candidate
change the covariance C to C - C Phi' (s² I + Phi C Phi')^-1 Phi C. The mean posterior variance over weighted target
states (V-optimality; Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007, ch. 10) falls by

    trace((s² I + Phi C Phi')^-1 Phi C T C Phi'),    T = weighted mean of the targets' outer products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

F = NDArray[np.float64]

EVERY_S = 0.02  # [s] between the rows of an experiment that count as independent
ERROR_VARIANCE = 0.15  # s²: of the error of one row, relative to the prior variance of the force
KNOWN_VARIANCE = 0.01  # of a state that counts as covered: its force is known to a tenth of what it could be


@dataclass(frozen=True)
class Information:
    """The posterior covariance (features, features) of the force's weights."""

    covariance: F

    @staticmethod
    def none(count: int) -> Information:
        """Return the prior: nothing is known."""
        return Information(np.eye(count))

    def add(self, rows: F) -> Information:
        """Return the information after rows (n, features)."""
        reach = rows @ self.covariance
        solved = cho_solve(self._factor(rows, reach), reach)
        covariance = self.covariance - reach.T @ solved
        return Information(0.5 * (covariance + covariance.T))

    def variance(self, rows: F) -> F:
        """Return the posterior variance (n,) at rows (n, features), 1 where nothing is known."""
        return np.asarray(np.einsum("ij,jk,ik->i", rows, self.covariance, rows, optimize=True))

    def coverage(self, rows: F) -> float:
        """Return the share of the states with these rows (n, features) that count as covered."""
        return float(np.mean(self.variance(rows) <= KNOWN_VARIANCE))

    def weigh(self, targets: F, weights: F) -> F:
        """Return C T C, which `gain` needs, for targets (m, features) with weights (m,)."""
        reach = targets @ self.covariance
        return np.asarray((reach * (weights / weights.sum())[:, None]).T @ reach)

    def gain(self, rows: F, weighed: F) -> float:
        """Return by how much rows (n, features) lower the weighted mean variance of the targets."""
        factor = self._factor(rows, rows @ self.covariance)
        return float(np.trace(cho_solve(factor, rows @ weighed @ rows.T)))

    @staticmethod
    def _factor(rows: F, reach: F) -> tuple[F, bool]:
        factor: tuple[F, bool] = cho_factor(reach @ rows.T + ERROR_VARIANCE * np.eye(len(rows)), lower=True)
        return factor
