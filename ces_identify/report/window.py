"""The window of a recording in the time plot: where the error is typical, or where the run diverged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.validation.evaluate import Evaluation

LENGTH_S = 1.5
BEFORE_DIVERGENCE = 0.8  # share of the window


@dataclass(frozen=True)
class Window:
    """Ticks [start, stop) and the reason for them in words."""

    start: int
    stop: int
    why: str


def choose_window(evaluation: Evaluation) -> Window:
    """Return the window of LENGTH_S whose local J is nearest the median of all windows.

    The local J is 100 times the RMS error in the window over the standard deviation of the whole scored force. Only
    windows with the most scored ticks count.
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
    best = np.flatnonzero(count == count.max())
    rms = np.sqrt(_sliding(square, length)[best] / max(count.max(), 1.0))
    local = 100.0 * rms / series.force[scored].std()
    typical = int(np.argmin(np.abs(local - np.median(local))))
    start = int(best[typical])
    why = f"typical: local J {local[typical]:.1f} %, median {np.median(local):.1f} %, worst {local.max():.1f} %"
    return Window(start, start + length, why)


def _sliding(values: F, length: int) -> F:
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(np.maximum(total[length:] - total[:-length], 0.0))
