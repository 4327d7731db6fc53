"""Derivatives of a tick of a neuro-fuzzy model, for the loop in lagged_kernels.py.

Parameters of a model with R regressors: for each rule its constant and linear part (R), then for each membership its
centre, log width and log slope.
"""

from __future__ import annotations

from math import log

from ces_data.arrays import F, I
from ces_identify.numerics.core import core_kernel
from ces_observer.tick.fuzzy import (
    FUZZY_BELLS, FUZZY_CHOICES, FUZZY_FIRED, FUZZY_FIRINGS, FUZZY_LAYER, FUZZY_MEMBERSHIPS, FUZZY_OUTPUTS, FUZZY_OWNERS,
    FUZZY_PREMISES, FUZZY_RULES, FUZZY_SCALE, FUZZY_SHAPES,
)  # fmt: skip
from ces_observer.tick.lagged import LAGGED_PHI


@core_kernel
def fill_fuzzy_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    """Fill `row` with the derivatives of a tick's force by the parameters, `gains` with those by the past forces."""
    scale, fired, premises, phi = p[FUZZY_SCALE], s[FUZZY_FIRED], n[FUZZY_PREMISES], n[LAGGED_PHI]
    layer, choice, output, firing = n[FUZZY_LAYER], n[FUZZY_CHOICES], n[FUZZY_OUTPUTS], n[FUZZY_FIRINGS]
    rules, r = n[FUZZY_RULES], len(gains) - premises
    bells = row[rules * (1 + r) :]
    bells[:] = 0.0
    gains[:] = 0.0
    at = 0
    for rule in range(rules):
        share = s[firing + rule] / fired
        part = scale * share
        row[at] = part
        for j in range(r):
            row[at + 1 + j] = part * s[phi + j]
            gains[j] += part * p[layer + j]
        pull = part * s[output + rule] - share * y  # of a rule on the force, through its memberships
        for q in range(premises):
            bells[3 * n[choice + q]] += pull
        at += 1 + r
        layer += 1 + r
        choice += premises
    for j in range(r):
        gains[j] /= past_spreads[j]
    shape, owner, membership = n[FUZZY_SHAPES], n[FUZZY_OWNERS], n[FUZZY_MEMBERSHIPS]
    for m in range(n[FUZZY_BELLS]):
        offset = s[phi + r + n[owner + m]] - p[shape]
        steep = bells[3 * m] * (1.0 - s[membership + m]) * p[shape + 2]
        bells[3 * m] = steep / offset if offset != 0.0 else 0.0
        bells[3 * m + 1] = steep
        bells[3 * m + 2] = -steep * log(abs(offset) / p[shape + 1]) if offset != 0.0 else 0.0
        shape += 3
