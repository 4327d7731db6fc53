"""Rates and quantiles with 95 % intervals, and the calibration of probabilities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

F = NDArray[np.float64]

RESAMPLES = 500
BINS = 10
Interval = tuple[float, float]


@dataclass(frozen=True)
class Statistic:
    """A figure and its number of cases, NaN if there are none; `interval` computes the 95 % interval."""

    value: float
    count: int
    interval: Callable[[], Interval]


def rate(hits: Sequence[bool]) -> Statistic:
    """Return the share of hits with Wilson's interval (J. Am. Stat. Assoc. 22, 1927)."""
    n = len(hits)

    def interval() -> Interval:
        low, high = binomtest(sum(hits), n).proportion_ci(method="wilson") if n else (nan, nan)
        return float(low), float(high)

    return Statistic(sum(hits) / n if n else nan, n, interval)


def quantile(values: Sequence[float], share: float) -> Statistic:
    """Return a quantile with the percentile interval of a bootstrap over cases."""
    return bootstrap_statistic(np.asarray(values, np.float64), lambda part: float(np.quantile(part, share)))


def mean(values: Sequence[float]) -> Statistic:
    """Return the mean with the percentile interval of a bootstrap over cases."""
    return bootstrap_statistic(np.asarray(values, np.float64), lambda part: float(part.mean()))


def bootstrap_statistic(cases: F, figure: Callable[[F], float]) -> Statistic:
    """Return `figure` of the cases (n, …), with the percentile interval over resamples of whole cases."""
    n = len(cases)

    def interval() -> Interval:
        rng = np.random.default_rng(0)
        resampled = [figure(cases[rng.integers(n, size=n)]) for _ in range(RESAMPLES if n else 0)]
        low, high = np.quantile(resampled, (0.025, 0.975)) if resampled else (nan, nan)
        return float(low), float(high)

    return Statistic(figure(cases) if n else nan, n, interval)


def calibration_error(probability: F, right: F) -> float:
    """Return the expected calibration error of probabilities against the truth, arrays of one shape, in ten bins."""
    probability, right = probability.ravel(), right.ravel()
    bins = np.minimum((probability * BINS).astype(int), BINS - 1)
    claimed, true = (np.bincount(bins, weights=weights, minlength=BINS) for weights in (probability, right))
    return float(np.abs(claimed - true).sum() / len(probability))


def brier(probability: F, right: F) -> float:
    """Return the mean over cases of the squared distance of probabilities from the truth, each (cases, candidates)."""
    return float(np.mean(np.sum((probability - right) ** 2, axis=1)))
