"""The window of a recording that the time plot shows first: where the damper works and the error is typical."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.validation.evaluate import Evaluation

LENGTH_S = 1.5
BEFORE_DIVERGENCE = 0.8  # share of the window
WORKING = 0.5  # of the work done where the damper works most: windows with less are not shown
MOST = 0.9  # quantile of the work over all windows that counts as most


@dataclass(frozen=True)
class Window:
    """Ticks [start, stop) and the reason for them in words."""

    start: int
    stop: int
    why: str


def choose_window(evaluation: Evaluation) -> Window:
    """Return the window of LENGTH_S in which the damper works and whose local J is nearest the median of such windows.

    The local J is 100 times the RMS error in the window over the standard deviation of the whole scored force. The
    damper works where the product of RMS speed and RMS variation of the force is large. Only windows with the most
    scored ticks count. A run that diverged shows where.
    """
    series, run = evaluation.series, evaluation.run
    length = max(2, round(LENGTH_S * series.rate_Hz))
    if length >= len(series):
        return Window(0, len(series), "the whole run")
    if run.diverged >= 0:
        start = int(np.clip(run.diverged - BEFORE_DIVERGENCE * length, 0, len(series) - length))
        return Window(start, start + length, f"where the free run diverged, at {series.time_s[run.diverged]:.2f} s")
    return _typical(evaluation, length)


def _typical(evaluation: Evaluation, length: int) -> Window:
    series, run = evaluation.series, evaluation.run
    scored = series.scored
    square = np.where(scored, (np.where(scored, series.force, 0.0) - run.force) ** 2, 0.0)
    count = _sliding(scored.astype(float), length)
    full = np.flatnonzero(count == count.max())
    work = _measure_work(evaluation, length)[full]
    best = full[work >= WORKING * np.quantile(work, MOST)]
    rms = np.sqrt(_sliding(square, length)[best] / max(count.max(), 1.0))
    local = 100.0 * rms / series.force[scored].std()
    typical = int(np.argmin(np.abs(local - np.median(local))))
    start = int(best[typical])
    why = f"typical: local J {local[typical]:.1f} %, median {np.median(local):.1f} %, worst {local.max():.1f} %"
    return Window(start, start + length, why)


def _measure_work(evaluation: Evaluation, length: int) -> F:
    """Return for each window of `length` ticks the product of RMS speed and RMS variation of the measured force."""
    series, scored = evaluation.series, evaluation.series.scored
    speed = np.where(scored, series.speed, 0.0)
    force = np.where(scored, series.force - series.force[scored].mean(), 0.0)
    return np.asarray(np.sqrt(_sliding(speed**2, length) * _sliding(force**2, length)))


def _sliding(values: F, length: int) -> F:
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(np.maximum(total[length:] - total[:-length], 0.0))
