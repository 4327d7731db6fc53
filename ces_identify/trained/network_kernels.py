"""Kernels of sigmoid networks: the force of a tick and its derivatives, for the loop in lagged_kernels.py.

Parameters of a network of R regressors: constant, linear (R), then for each unit its weight, bias and slopes (R). Slow
reference: `ces_observer.structures.network.NetworkRun`.
"""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.numerics.normal_matrix import propagate
from ces_identify.trained.lagged_kernels import RegressorTable, fill_regressors, register


class NetworkArrays(NamedTuple):
    """A network: force [N] = scale · output, with its `params` and number of units."""

    scale: float
    params: F
    units: int


@njit(cache=True, nogil=True)
def network_tick(phi: F, params: F, sigmoids: F) -> float:
    """Return the scaled output at the regressors `phi`; fill `sigmoids` (units,)."""
    r = len(phi)
    total: float = params[0]
    for j in range(r):
        total += params[1 + j] * phi[j]
    at = 1 + r
    for i in range(len(sigmoids)):
        x = params[at + 1]
        for j in range(r):
            x += params[at + 2 + j] * phi[j]
        sigmoids[i] = 1.0 / (1.0 + exp(min(-x, 700.0)))
        total += params[at] * sigmoids[i]
        at += 2 + r
    return total


@njit(cache=True, nogil=True)
def network_slopes(
    phi: F, params: F, sigmoids: F, scale: float, past_lags: I, past_spreads: F, row: F, gains: F
) -> None:
    """Fill `row` with the derivatives of one tick's force by the parameters, `gains` with those by the past forces."""
    r = len(phi)
    row[0] = scale
    for j in range(r):
        row[1 + j] = scale * phi[j]
        gains[j] = scale * params[1 + j]
    at = 1 + r
    for i in range(len(sigmoids)):
        weight, s = params[at], sigmoids[i]
        steep = scale * weight * s * (1.0 - s)
        row[at] = scale * s
        row[at + 1] = steep
        for j in range(r):
            row[at + 2 + j] = steep * phi[j]
            if past_lags[j] > 0:
                gains[j] += steep * params[at + 2 + j]
        at += 2 + r
    for j in range(r):
        gains[j] /= past_spreads[j]


def _run_block(
    arrays: NetworkArrays, table: RegressorTable, k0: int, n: int, past: F, now: int, low: float, high: float, slopes: F
) -> int:
    scale, params, units = arrays
    values, past_lags, past_means, past_spreads = table
    phi, gains, sigmoids = np.empty(values.shape[1]), np.empty(values.shape[1]), np.empty(units)
    for i in range(n):
        fill_regressors(phi, values[k0 + i], past_lags, past_means, past_spreads, past, now + i)
        y = scale * network_tick(phi, params, sigmoids)
        past[now + i] = y
        if not low <= y <= high:
            return i
        if len(slopes) > 0:
            network_slopes(phi, params, sigmoids, scale, past_lags, past_spreads, slopes[now + i], gains)
            propagate(slopes, now + i, past_lags, gains)
    return n


register(NetworkArrays, lambda arrays: len(arrays.params), _run_block)
