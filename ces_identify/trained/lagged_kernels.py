"""The loop of all fits on lagged regressors: the free run, and its sensitivities to every parameter.

The force is that of `ces_observer.tick`; a structure adds the derivatives of a tick. `segments[s] = (start, stop)` are
ticks without a gap; forces before them are zero.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import inf
from typing import Any, NamedTuple

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.core import compiled, pointer, with_names
from ces_identify.numerics.normal_matrix import BLOCK, accumulate, longest_lag, mirror, propagate
from ces_observer.tick.lagged import LAGGED_PHI


class RegressorTable(NamedTuple):
    """Regressors over the ticks: `values` (ticks, regressors), 0 where a past force belongs.

    `past_lags` (regressors,) is the lag of a past force, 0 for an input; `past_means` and `past_spreads` scale it.
    """

    values: F
    past_lags: I
    past_means: F
    past_spreads: F


def _force(p: F, n: I, s: F) -> float:
    raise NotImplementedError


def _fill_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    raise NotImplementedError


def _normal_equations(
    numbers: F, counts: I, states: F, table: RegressorTable, segments: I, parameters: int, low: float, high: float,
    measured: F, weights: F, max_error: float,
) -> tuple[float, F, F]:  # fmt: skip
    p, n, s = pointer(numbers), pointer(counts), pointer(states)
    values, past_lags, past_means, past_spreads = table
    width, phi, depth = values.shape[1], n[LAGGED_PHI], longest_lag(past_lags)
    matrix, gradient, gains = np.zeros((parameters, parameters)), np.zeros(parameters), np.empty(width)
    past, slopes = np.empty(depth + BLOCK), np.empty((depth + BLOCK, parameters))
    total = 0.0
    for segment in range(len(segments)):
        start, stop = segments[segment, 0], segments[segment, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            ticks = min(k0 + BLOCK, stop) - k0
            for now in range(depth, depth + ticks):
                for j in range(width):
                    s[phi + j] = values[k0 + now - depth, j]
                    if past_lags[j] > 0:
                        s[phi + j] = (past[now - past_lags[j]] - past_means[j]) / past_spreads[j]
                y = _force(p, n, s)
                past[now] = y
                if not low <= y <= high:
                    return inf, matrix, gradient
                _fill_slopes(p, n, s, y, past_lags, past_spreads, slopes[now], gains)
                propagate(slopes, now, past_lags, gains)
            errors = measured[k0 : k0 + ticks] - past[depth : depth + ticks]
            total += accumulate(matrix, gradient, slopes[depth : depth + ticks], errors, weights[k0 : k0 + ticks])
            if total > max_error:
                return inf, matrix, gradient
            past[:depth] = past[ticks : ticks + depth].copy()
            slopes[:depth] = slopes[ticks : ticks + depth].copy()
    mirror(matrix)
    return total, matrix, gradient


@cache
def normal_equations(force: Callable[..., float], fill_slopes: Callable[..., None]) -> Any:
    """Return the function of weighted squared error, Gauss-Newton matrix and (descending) gradient of the free run.

    `run(p, n, s, table, segments, parameters, low, high, measured, weights, max_error)` takes arrays of the tick. If
    the force leaves [low, high] or the error exceeds `max_error`, the error is infinite and the rest incomplete.

    `force(p, n, s)` is a function of the tick: the force at the regressors in s. `fill_slopes(p, n, s, y, past_lags,
    past_spreads, row, gains)` is a kernel that is called after it: it fills `row` (parameters,) with the derivatives of
    this force y by the parameters, and `gains` (regressors,) with those by the past forces.
    """
    names = {"_force": compiled(force), "_fill_slopes": fill_slopes}
    return with_names(_normal_equations, f"normal_equations_{force.__name__}", names)
