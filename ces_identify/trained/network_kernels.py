"""Kernels of sigmoid networks: the free run, and its sensitivities to every parameter.

Parameters of a network of R regressors: constant, linear (R), then for each unit its weight, bias and slopes (R).
Regressors come as the arrays of `lagged_table.Table`; `segments[s] = (start, stop)` are ticks without a gap, before
which forces count as zero. Slow readable twin: `ces_observer.structures.network.NetworkRun`.
"""

from __future__ import annotations

from math import exp, inf

import numpy as np
from numba import njit

from ces_identify.numerics.normal_matrix import BLOCK, F, I, accumulate, deepest, mirror, propagate


@njit(cache=True, nogil=True)
def network_tick(phi: F, params: F, risen: F) -> float:
    """Return the scaled output at the regressors `phi`; fills `risen` (units,) with the sigmoids."""
    r = len(phi)
    total: float = params[0]
    for j in range(r):
        total += params[1 + j] * phi[j]
    at = 1 + r
    for i in range(len(risen)):
        x = params[at + 1]
        for j in range(r):
            x += params[at + 2 + j] * phi[j]
        risen[i] = 1.0 / (1.0 + exp(min(-x, 700.0)))
        total += params[at] * risen[i]
        at += 2 + r
    return total


@njit(cache=True, nogil=True)
def network_free_run(
    values: F,
    past_lags: I,
    past_means: F,
    past_spreads: F,
    segments: I,
    scale: float,
    params: F,
    low: float,
    high: float,
) -> tuple[F, int]:
    """Simulate every segment from its own past forces.

    Returns force (ticks,) [N], NaN from where it left [low, high] to the end of that segment, and the first such
    tick, or -1.
    """
    ticks, r = values.shape
    force = np.zeros(ticks)
    phi = np.empty(r)
    risen = np.empty((len(params) - 1 - r) // (2 + r))
    first = -1
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        for k in range(start, stop):
            for j in range(r):
                phi[j] = values[k, j]
                if past_lags[j] > 0:
                    past = force[k - past_lags[j]] if k - past_lags[j] >= start else 0.0
                    phi[j] = (past - past_means[j]) / past_spreads[j]
            force[k] = scale * network_tick(phi, params, risen)
            if not low <= force[k] <= high:
                force[k:stop] = np.nan
                first = k if first < 0 else first
                break
    return force, first


@njit(cache=True, nogil=True)
def network_normal_equations(
    values: F,
    past_lags: I,
    past_means: F,
    past_spreads: F,
    segments: I,
    scale: float,
    params: F,
    low: float,
    high: float,
    measured: F,
    weights: F,
    most: float,
) -> tuple[float, F, F]:
    """Return the weighted squared error of the free run, its Gauss-Newton matrix and (descending) gradient.

    The error is infinite, and the rest unfinished, if the force leaves [low, high] or the error exceeds `most`.
    """
    r = values.shape[1]
    n_params = len(params)
    depth = deepest(past_lags)
    matrix = np.zeros((n_params, n_params))
    gradient = np.zeros(n_params)
    past = np.empty(depth + BLOCK)
    slopes = np.empty((depth + BLOCK, n_params))
    errors = np.empty(BLOCK)
    phi = np.empty(r)
    gains = np.zeros(r)
    risen = np.empty((n_params - 1 - r) // (2 + r))
    total = 0.0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            n = min(k0 + BLOCK, stop) - k0
            for i in range(n):
                for j in range(r):
                    phi[j] = values[k0 + i, j]
                    if past_lags[j] > 0:
                        phi[j] = (past[depth + i - past_lags[j]] - past_means[j]) / past_spreads[j]
                y = scale * network_tick(phi, params, risen)
                if not low <= y <= high:
                    return inf, matrix, gradient
                past[depth + i] = y
                errors[i] = measured[k0 + i] - y
                _direct(phi, params, risen, scale, past_lags, slopes[depth + i], gains)
                for j in range(r):
                    gains[j] /= past_spreads[j]
                propagate(slopes, depth + i, past_lags, gains)
            total += accumulate(matrix, gradient, slopes[depth : depth + n], errors[:n], weights[k0 : k0 + n])
            if total > most:
                return inf, matrix, gradient
            past[:depth] = past[n : n + depth].copy()
            slopes[:depth] = slopes[n : n + depth].copy()
    mirror(matrix)
    return total, matrix, gradient


@njit(cache=True, nogil=True)
def _direct(phi: F, params: F, risen: F, scale: float, past_lags: I, row: F, gains: F) -> None:
    """Fill `row` with the derivative of one tick's force by the parameters, `gains` with that by the past forces."""
    r = len(phi)
    row[0] = scale
    for j in range(r):
        row[1 + j] = scale * phi[j]
        gains[j] = scale * params[1 + j]
    at = 1 + r
    for i in range(len(risen)):
        weight, s = params[at], risen[i]
        steep = scale * weight * s * (1.0 - s)
        row[at] = scale * s
        row[at + 1] = steep
        for j in range(r):
            row[at + 2 + j] = steep * phi[j]
            if past_lags[j] > 0:
                gains[j] += steep * params[at + 2 + j]
        at += 2 + r
