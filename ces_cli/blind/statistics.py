"""Rates, quantiles, means and the calibration of probabilities, with 95 % intervals that hold for few cases, too.

Cases are drawn independently of each other, so that nothing of the errors of recordings (`numerics/sum_error.py`)
applies here. An end of an interval that so few cases do not bound is infinite.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf, nan, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, norm, t

F = NDArray[np.float64]

LEVEL = 0.95
TAIL = 0.5 * (1.0 - LEVEL)
BINS = 10
Interval = tuple[float, float]
UNKNOWN = (nan, nan)


@dataclass(frozen=True)
class Statistic:
    """A figure and its number of cases, NaN if there are none; `interval` computes the 95 % interval."""

    value: float
    count: int
    interval: Callable[[], Interval]


def rate(hits: Sequence[bool], cases: int | None = None) -> Statistic:
    """Return the share of hits with Wilson's interval (J. Am. Stat. Assoc. 22, 1927).

    Several hits of one case are not independent: with the number of `cases`, the interval is that of so many.
    """
    n = len(hits)
    share = sum(hits) / n if n else nan
    return Statistic(share, n, lambda: wilson_interval(share, n if cases is None else cases) if n else UNKNOWN)


def wilson_interval(share: float, count: int) -> Interval:
    """Return Wilson's interval of a share of `count` independent trials."""
    z2 = float(norm.isf(TAIL)) ** 2
    middle = (share + 0.5 * z2 / count) / (1.0 + z2 / count)
    half = sqrt(z2 * (share * (1.0 - share) / count + 0.25 * z2 / count**2)) / (1.0 + z2 / count)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def quantile(values: Sequence[float], share: float) -> Statistic:
    """Return a quantile with the interval between two of the ordered values, whatever their distribution.

    The number of values below the true quantile is binomial (Conover, Practical Nonparametric Statistics, section 3.2).
    """
    ordered, n = np.sort(np.asarray(values, np.float64)), len(values)

    def interval() -> Interval:
        below = int(binom.ppf(TAIL, n, share))  # fewer than these are too few
        above = int(binom.isf(TAIL, n, share))  # more than these are too many
        return (float(ordered[below - 1]) if below > 0 else -inf, float(ordered[above]) if above < n else inf)

    return Statistic(float(np.quantile(ordered, share)) if n else nan, n, interval if n else lambda: UNKNOWN)


def mean(values: Sequence[float]) -> Statistic:
    """Return the mean with Student's interval, which one case does not bound."""
    cases = np.asarray(values, np.float64)
    n = len(cases)

    def interval() -> Interval:
        half = float(t.isf(TAIL, n - 1) * cases.std(ddof=1) / sqrt(n)) if n > 1 else inf
        return float(cases.mean()) - half, float(cases.mean()) + half

    return Statistic(float(cases.mean()) if n else nan, n, interval if n else lambda: UNKNOWN)


def calibration_error(probability: F, right: F) -> Statistic:
    """Return the expected calibration error in ten equal bins of probabilities (cases, candidates) against the truth.

    It is the sum of the bins' absolute differences between claimed and true shares. Of few cases it is above zero even
    if the probabilities are right. By the triangle inequality it misses the true one by no more than the sum of the
    bins' absolute errors; these are taken as normal and independent.
    """
    n = len(probability)
    if n == 0:
        return Statistic(nan, 0, lambda: UNKNOWN)
    differences = _sum_in_bins(probability, probability - right) / probability.size  # (cases, bins)
    value = float(np.abs(differences.sum(axis=0)).sum())

    def interval() -> Interval:
        errors = np.maximum(_spread_of_sums(differences), _binomial_errors(probability, right))
        half = sqrt(2.0 / np.pi) * errors.sum() + norm.isf(TAIL) * sqrt(1.0 - 2.0 / np.pi) * np.hypot.reduce(errors)
        return max(value - float(half), 0.0), value + float(half)

    return Statistic(value, n, interval)


def _sum_in_bins(probability: F, values: F) -> F:
    """Return the sums (cases, bins) of the values of each case by the bin of their probabilities."""
    bins = np.minimum((probability * BINS).astype(int), BINS - 1)
    return np.stack([np.where(bins == b, values, 0.0).sum(axis=1) for b in range(BINS)], axis=1)


def _spread_of_sums(parts: F) -> F:
    """Return the standard errors (bins,) of the sums of parts (cases, bins) over independent cases."""
    n = len(parts)
    return np.asarray(np.sqrt(n) * parts.std(axis=0, ddof=1)) if n > 1 else np.abs(parts[0])


def _binomial_errors(probability: F, right: F) -> F:
    """Return the standard errors (bins,) of the true shares, by Laplace's rule: few equal cases vary, too."""
    count, hits = (_sum_in_bins(probability, v).sum(axis=0) for v in (np.ones_like(right), right))
    share = (hits + 1.0) / (count + 2.0)
    return np.asarray(np.sqrt(count * share * (1.0 - share)) / probability.size)


def brier(probability: F, right: F) -> Statistic:
    """Return the mean over cases of the squared distance of probabilities from the truth, each (cases, candidates)."""
    return mean(np.sum((probability - right) ** 2, axis=1).tolist())
