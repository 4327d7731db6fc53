"""Differences of the cost J between models on the same recordings, with their standard errors.

The difference of two models is a sum over time, to first order: of the influence of each stretch of time on it. What
the errors of two models have in common (noise, a road's rough parts) cancels there. `ces_identify.numerics.sum_error`
gives the standard error of that sum for each recording, and what it assumes; recordings are independent of each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.numerics.arrays import F
from ces_identify.numerics.sum_error import MIN_BINS, SLOWEST_S, SumError, add_errors, estimate_sum_error, sum_bins

ROUNDING = 1e-4  # of the cost: smaller differences are rounding, not better models
MIN_SECONDS = 2.0 * SLOWEST_S  # of all recordings together

Pair = tuple[int, int]


@dataclass(frozen=True)
class DifferenceErrors:
    """A difference of J [%], first minus second model, over `seconds`; `error` is None with a recording too short.

    A difference up to `rounding` [%] is none.
    """

    value: float
    error: SumError | None
    seconds: float
    rounding: float

    @property
    def is_rounding(self) -> bool:
        """Whether the difference is no more than rounding, as that of a model and its own FMU."""
        return abs(self.value) <= self.rounding

    def p_value(self) -> float:
        """Return the p-value that the true difference is zero; 1 without an error, or for rounding."""
        return 1.0 if self.error is None or self.is_rounding else self.error.p_value(self.value)

    def interval(self, level: float) -> tuple[float, float]:
        """Return the interval [%] that holds the true value by `level` (0 to 1); endless without an error."""
        half = np.inf if self.error is None else self.error.half_width(level)
        half = max(half, abs(self.value)) if self.is_rounding else half
        return float(self.value - half), float(self.value + half)

    def is_too_short(self, alpha: float) -> bool:
        """Return whether a longer recording may find a difference at the level `alpha` that this one cannot show.

        So it is if there are fewer than MIN_SECONDS, or if the difference would count, were nothing slow possible.
        """
        if self.error is None:
            return True
        if self.is_rounding or self.p_value() < alpha:
            return False
        return self.seconds < MIN_SECONDS or self.error.fast_p_value(self.value) < alpha


def pooled_costs(recordings: Sequence[AlignedRecording]) -> F:
    """Return J [%] of each model (models,) over all recordings, each force relative to its recording's mean."""
    squares = sum((r.errors**2).sum(axis=1) for r in recordings)
    return np.asarray(100.0 * np.sqrt(squares / sum(map(_spread, recordings))))


def find_differences(recordings: Sequence[AlignedRecording], pairs: Sequence[Pair]) -> list[DifferenceErrors]:
    """Return the difference of pooled J, with its error, for each pair of models; none of them may have diverged."""
    costs, seconds = pooled_costs(recordings), sum(r.seconds for r in recordings)
    influences = [influence_of_bins(r, costs, sum(map(_spread, recordings))) for r in recordings]
    enough = all(one.shape[1] >= MIN_BINS for one in influences)
    return [
        DifferenceErrors(
            float(costs[first] - costs[second]),
            add_errors(
                [
                    estimate_sum_error(one[first] - one[second], r.seconds)
                    for one, r in zip(influences, recordings, strict=True)
                ]
            )
            if enough
            else None,
            seconds,
            ROUNDING * float(max(costs[first], costs[second])),
        )
        for first, second in pairs
    ]


def _spread(recording: AlignedRecording) -> float:
    force = recording.measured[recording.scored]
    return float(((force - force.mean()) ** 2).sum())


def influence_of_bins(recording: AlignedRecording, costs: F, spread: float) -> F:
    """Return the influence [%] of each bin of BIN_S on the pooled cost of each model (models, bins).

    J = 100 sqrt(S / Y) with the sums S of squared errors and Y = `spread`: dJ = J / 2 (dS / S - dY / Y).
    """
    force = recording.measured[recording.scored]
    squares = sum_bins(recording.errors**2, recording.rate_Hz)
    of_force = sum_bins((force - force.mean()) ** 2, recording.rate_Hz)
    per_square = 0.5 * 100.0**2 / np.maximum(costs, 1e-300) / spread  # J / (2 S)
    return np.asarray(per_square[:, None] * squares - 0.5 * costs[:, None] * of_force / spread)


def all_pairs(models: Sequence[int]) -> list[Pair]:
    """Return every pair of models once, in order."""
    return list(combinations(models, 2))
