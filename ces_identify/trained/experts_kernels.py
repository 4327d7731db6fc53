"""Derivatives of a tick of gated experts, for the loop in lagged_kernels.py.

Parameters of E experts on R inputs: the rows of the layer, gates, linear and bend (each E rows of R + 1 numbers), then
a, d and s of each expert.
"""

from __future__ import annotations

from ces_data.arrays import F, I
from ces_identify.numerics.core import core_kernel
from ces_observer.tick.experts import (
    EXPERTS_COUNT, EXPERTS_GAINS, EXPERTS_LAYER, EXPERTS_OUTPUTS, EXPERTS_SCALE,
)  # fmt: skip
from ces_observer.tick.lagged import LAGGED_PHI


@core_kernel
def fill_experts_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    """Fill `row` with the derivatives of a tick's force by the parameters, `gains` with those by the past forces."""
    scale, phi, share, gain, r = p[EXPERTS_SCALE], n[LAGGED_PHI], n[EXPERTS_OUTPUTS], n[EXPERTS_GAINS], len(gains) - 1
    count, past, blended = n[EXPERTS_COUNT], s[n[LAGGED_PHI] + r], y / p[EXPERTS_SCALE]
    block, gains[:] = count * (r + 1), 0.0
    layer = n[EXPERTS_LAYER] + 2 * block
    for i in range(count):
        part = scale * s[share + i]
        bend = s[share + 2 * count + i]
        steep = part * (1.0 - bend * bend)
        gate = part * (s[share + count + i] - blended)
        at, bent = i * (r + 1), p[layer + i * (r + 1) + r] + p[gain + 1] * past
        for j in range(r):
            u = s[phi + j]
            bent += p[layer + at + j] * u
            row[at + j] = gate * u
            row[block + at + j] = part * u
            row[2 * block + at + j] = steep * u
        row[at + r], row[block + at + r], row[2 * block + at + r] = gate, part, steep
        at = 3 * block + 3 * i
        row[at] = part * past
        row[at + 1] = steep * past
        row[at + 2] = part * bend - steep * bent / p[gain + 2]
        gains[r] += part * p[gain] + steep * p[gain + 1]
        gain += 3
    gains[r] /= past_spreads[r]
