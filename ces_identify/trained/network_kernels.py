"""Derivatives of a tick of a sigmoid network, for the loop in lagged_kernels.py.

Parameters of a network of R regressors: constant, linear (R), then for each unit its weight, bias and slopes (R).
"""

from __future__ import annotations

from ces_data.arrays import F, I
from ces_identify.numerics.core import core_kernel
from ces_observer.tick.lagged import LAGGED_PHI
from ces_observer.tick.sigmoid import SIGMOID_LAYER, SIGMOID_OUTPUTS, SIGMOID_SCALE, SIGMOID_UNITS, SIGMOID_WEIGHTS


@core_kernel
def fill_sigmoid_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    """Fill `row` with the derivatives of a tick's force by the parameters, `gains` with those by the past forces."""
    scale, layer, phi, r = p[SIGMOID_SCALE], n[SIGMOID_LAYER], n[LAGGED_PHI], len(gains)
    row[0] = scale
    for j in range(r):
        row[1 + j] = scale * s[phi + j]
        gains[j] = scale * p[layer + j]
    at = 1 + r
    for i in range(n[SIGMOID_UNITS]):
        layer += 1 + r
        sigmoid = s[n[SIGMOID_OUTPUTS] + 1 + i]
        steep = scale * p[n[SIGMOID_WEIGHTS] + i] * sigmoid * (1.0 - sigmoid)
        row[at] = scale * sigmoid
        row[at + 1] = steep
        for j in range(r):
            row[at + 2 + j] = steep * s[phi + j]
            if past_lags[j] > 0:
                gains[j] += steep * p[layer + j]
        at += 2 + r
    for j in range(r):
        gains[j] /= past_spreads[j]
