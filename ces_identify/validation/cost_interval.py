"""The confidence interval of a cost J over the scored ticks of one or several free runs.

J is a ratio of two sums. The influence of a tick on its logarithm is, to first order,

    (e^2 / sum(e^2) - (y - mean y)^2 / sum((y - mean y)^2)) / 2

and `ces_identify.numerics.sum_error` gives the standard error of the sum of that over each recording, with what it
assumes on slow changes. The interval is J times and divided by one factor. It says how J would vary over other
stretches of the same experiments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.numerics.sum_error import MIN_BINS, add_errors, estimate_sum_error, sum_bins
from ces_identify.validation.evaluate import Evaluation

LEVEL = 0.95
MAX_FACTOR = 3.0  # between J and an end of its interval; beyond it, the recordings are too short


@dataclass(frozen=True)
class CostInterval:
    """J is between `low` and `high` [%] with probability LEVEL."""

    low: float
    high: float


@dataclass(frozen=True)
class ScoredTicks:
    """The scored ticks of a recording in order: `squares` of the error (n,) [N²] and measured `force` (n,) [N]."""

    squares: F
    force: F
    rate_Hz: float

    @property
    def spread(self) -> F:
        """Squared distance of the force from its mean (n,) [N²]."""
        return np.asarray((self.force - self.force.mean()) ** 2)


def cost_interval(evaluations: Sequence[Evaluation]) -> CostInterval | None:
    """Return the interval of J over all `evaluations` together; None if a run diverged or they are too short.

    Errors and forces are pooled, each force relative to its recording's mean.
    """
    if not all(np.isfinite(evaluation.cost) for evaluation in evaluations):
        return None
    return interval_of_ticks([scored_ticks(e) for e in evaluations])


def interval_of_ticks(recordings: Sequence[ScoredTicks]) -> CostInterval | None:
    """Return the interval of J over recordings of finite forces; None if they are too short."""
    squares, spread = _sums(recordings)
    influences = [_influence_of_bins(ticks, squares, spread) for ticks in recordings]
    if min(map(len, influences)) < MIN_BINS:
        return None
    seconds = [len(ticks.force) / ticks.rate_Hz for ticks in recordings]
    error = add_errors([estimate_sum_error(x, s) for x, s in zip(influences, seconds, strict=True)])
    factor = float(np.exp(error.half_width(LEVEL)))
    cost = 100.0 * float(np.sqrt(squares / spread))
    return CostInterval(cost / factor, cost * factor) if factor <= MAX_FACTOR else None


def pooled_cost(evaluations: Sequence[Evaluation]) -> float:
    """Return J [%] over all ticks of `evaluations`, each force relative to its recording's mean."""
    squares, spread = _sums([scored_ticks(e) for e in evaluations])
    return float(100.0 * np.sqrt(squares / spread))


def scored_ticks(evaluation: Evaluation) -> ScoredTicks:
    """Return the scored ticks of `evaluation`."""
    series = evaluation.series
    return ScoredTicks(evaluation.error**2, series.force[series.scored], series.rate_Hz)


def _sums(recordings: Sequence[ScoredTicks]) -> tuple[float, float]:
    return sum(float(t.squares.sum()) for t in recordings), sum(float(t.spread.sum()) for t in recordings)


def _influence_of_bins(ticks: ScoredTicks, squares: float, spread: float) -> F:
    """Return the influence of each bin of BIN_S on the logarithm of J."""
    influence = 0.5 * (ticks.squares / max(squares, 1e-300) - ticks.spread / spread)
    return sum_bins(influence, ticks.rate_Hz)
