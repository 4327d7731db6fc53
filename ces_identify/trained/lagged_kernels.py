"""The loop of all models on lagged regressors: the free run, and its sensitivities to every parameter.

A structure passes a NamedTuple of its arrays. Numba selects the structure's functions by that type, once `register` has
been called beside its arrays. `segments[s] = (start, stop)` are ticks without a gap; forces before them are zero.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from ces_data.arrays import F, I, Mask
from ces_identify.numerics.normal_matrix import BLOCK, accumulate, longest_lag, mirror


class RegressorTable(NamedTuple):
    """Regressors over the ticks: `values` (ticks, regressors), 0 where a past force belongs.

    `past_lags` (regressors,) is the lag of a past force, 0 for an input; `past_means` and `past_spreads` scale it.
    """

    values: F
    past_lags: I
    past_means: F
    past_spreads: F


def register(arrays: type, count: Callable[..., int], run_block: Callable[..., int]) -> None:
    """Let the loop run models whose arrays have this type, with functions that Numba can compile.

    `count(arrays)` is the number of parameters. `run_block(arrays, table, k0, n, past, now, low, high, slopes)` runs
    the `n` ticks from `k0` and returns how many it completed: all, or those before the force left [low, high]. It
    writes the force [N] of tick k0 + i, also of the first outside, to past[now + i] and, unless `slopes` is empty, its
    sensitivities to slopes[now + i]; earlier ticks precede them.
    """

    def choose(function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda first, *rest: function if getattr(first, "instance_class", None) is arrays else None

    overload(_count, strict=False)(choose(count))
    overload(_run_block, strict=False)(choose(run_block))


def _count(arrays: Any) -> int:
    raise NotImplementedError


def _run_block(
    arrays: Any, table: RegressorTable, k0: int, n: int, past: F, now: int, low: float, high: float, slopes: F
) -> int:
    raise NotImplementedError


@njit(cache=True, nogil=True)
def lagged_free_run(table: RegressorTable, segments: I, arrays: Any, low: float, high: float) -> tuple[F, Mask]:
    """Simulate every segment from its own past forces, which are held in [low, high].

    Returns force (ticks,) [N], NaN from where it is not finite to the end of that segment, and where it was held.
    """
    depth = longest_lag(table.past_lags)
    force, held = np.zeros(len(table.values)), np.zeros(len(table.values), np.bool_)
    none = np.empty((0, 0))
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        past, k = np.zeros(depth + stop - start), start
        while k < stop:
            k += _run_block(arrays, table, k, stop - k, past, depth + k - start, low, high, none)
            if k < stop:
                y = past[depth + k - start]
                if not isfinite(y):
                    past[depth + k - start :] = np.nan
                    break
                past[depth + k - start] = min(max(y, low), high)
                held[k] = True
                k += 1
        force[start:stop] = past[depth:]
    return force, held


@njit(cache=True, nogil=True)
def lagged_normal_equations(
    table: RegressorTable, segments: I, arrays: Any, low: float, high: float, measured: F, weights: F, max_error: float
) -> tuple[float, F, F]:
    """Return the weighted squared error of the free run, its Gauss-Newton matrix and (descending) gradient.

    If the force leaves [low, high] or the error exceeds `max_error`, the error is infinite and the rest incomplete.
    """
    n_params, depth = _count(arrays), longest_lag(table.past_lags)
    matrix, gradient = np.zeros((n_params, n_params)), np.zeros(n_params)
    past, slopes = np.empty(depth + BLOCK), np.empty((depth + BLOCK, n_params))
    total = 0.0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            n = min(k0 + BLOCK, stop) - k0
            if _run_block(arrays, table, k0, n, past, depth, low, high, slopes) < n:
                return inf, matrix, gradient
            errors = measured[k0 : k0 + n] - past[depth : depth + n]
            total += accumulate(matrix, gradient, slopes[depth : depth + n], errors, weights[k0 : k0 + n])
            if total > max_error:
                return inf, matrix, gradient
            past[:depth] = past[n : n + depth].copy()
            slopes[:depth] = slopes[n : n + depth].copy()
    mirror(matrix)
    return total, matrix, gradient


@njit(cache=True, nogil=True)
def fill_regressors(phi: F, values: F, past_lags: I, past_means: F, past_spreads: F, past: F, now: int) -> None:
    """Fill `phi` with the regressors of a tick, from its row of `values` and the forces before past[now]."""
    for j in range(len(phi)):
        phi[j] = values[j]
        if past_lags[j] > 0:
            phi[j] = (past[now - past_lags[j]] - past_means[j]) / past_spreads[j]
