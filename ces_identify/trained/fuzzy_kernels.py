"""Kernels of neuro-fuzzy models: the force of a tick and its derivatives, for the loop in lagged_kernels.py.

`consequents` (rules, 1 + R) hold each rule's constant and linear part over R regressors; `bells` (memberships, 3) the
centre, log width and log slope of each membership; `owner` (memberships,) its premise, a column of `premises` (ticks,
premises); `rules` (rules, premises) each rule's membership of each premise. A parameter vector is `consequents`, then
`bells`, row by row. Slow reference: `ces_observer.structures.fuzzy.FuzzyRun`.
"""

from __future__ import annotations

from math import exp, log
from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I
from ces_identify.numerics.normal_matrix import propagate
from ces_identify.trained.lagged_kernels import RegressorTable, fill_regressors, register


class FuzzyArrays(NamedTuple):
    """A neuro-fuzzy model: force [N] = scale · output, with `premises` over the ticks."""

    scale: float
    premises: F
    owner: I
    rules: I
    consequents: F
    bells: F


@njit(cache=True, nogil=True)
def grade(x: F, bells: F, owner: I, grades: F, logs: F) -> None:
    """Fill `grades` (memberships,), and `logs` with the log distances from the centres in widths, at premises `x`."""
    for m in range(len(owner)):
        distance = abs(x[owner[m]] - bells[m, 0])
        if distance == 0.0:
            logs[m], grades[m] = 0.0, 1.0
        else:
            logs[m] = log(distance) - bells[m, 1]
            grades[m] = 1.0 / (1.0 + exp(2.0 * exp(bells[m, 2]) * logs[m]))


@njit(cache=True, nogil=True)
def share(grades: F, rules: I, shares: F) -> None:
    """Fill `shares` (rules,) with each rule's share of the total firing."""
    total = 0.0
    for r in range(len(rules)):
        firing = 1.0
        for q in range(rules.shape[1]):
            firing *= grades[rules[r, q]]
        shares[r] = firing
        total += firing
    for r in range(len(rules)):
        shares[r] /= total


@njit(cache=True, nogil=True)
def fuzzy_tick(phi: F, consequents: F, shares: F, outputs: F) -> float:
    """Return the scaled output at the regressors `phi`; fill `outputs` (rules,) with each rule's output."""
    total = 0.0
    for r in range(len(shares)):
        y = consequents[r, 0]
        for j in range(len(phi)):
            y += consequents[r, 1 + j] * phi[j]
        outputs[r] = y
        total += shares[r] * y
    return total


@njit(cache=True, nogil=True)
def _consequent_slopes(
    phi: F, consequents: F, shares: F, scale: float, past_lags: I, past_spreads: F, row: F, gains: F
) -> None:
    """Fill the consequents' part of `row`, and `gains` with the derivatives of the force by the past forces."""
    width = len(phi)
    gains[:] = 0.0
    at = 0
    for r in range(len(shares)):
        part = scale * shares[r]
        row[at] = part
        for j in range(width):
            row[at + 1 + j] = part * phi[j]
            if past_lags[j] > 0:
                gains[j] += part * consequents[r, 1 + j] / past_spreads[j]
        at += 1 + width


@njit(cache=True, nogil=True)
def _premise_slopes(
    x: F, bells: F, owner: I, rules: I, grades: F, logs: F, shares: F, outputs: F, blended: float, scale: float, row: F
) -> None:
    """Fill `row` (3 memberships,) with the derivatives of one tick's force by centre, log width and log slope."""
    row[:] = 0.0
    for r in range(len(rules)):
        pull = scale * shares[r] * (outputs[r] - blended)
        for q in range(rules.shape[1]):
            row[3 * rules[r, q]] += pull
    for m in range(len(owner)):
        offset = x[owner[m]] - bells[m, 0]
        twice = 2.0 * exp(bells[m, 2])
        steep = row[3 * m] * (1.0 - grades[m]) * twice
        row[3 * m] = steep / offset if offset != 0.0 else 0.0
        row[3 * m + 1] = steep
        row[3 * m + 2] = -steep * logs[m]


def _run_block(
    arrays: FuzzyArrays, table: RegressorTable, k0: int, n: int, past: F, now: int, low: float, high: float, slopes: F
) -> int:
    scale, premises, owner, rules, consequents, bells = arrays
    values, past_lags, past_means, past_spreads = table
    phi, gains = np.empty(values.shape[1]), np.empty(values.shape[1])
    grades, logs = np.empty(len(owner)), np.empty(len(owner))
    shares, outputs = np.empty(len(rules)), np.empty(len(rules))
    for i in range(n):
        fill_regressors(phi, values[k0 + i], past_lags, past_means, past_spreads, past, now + i)
        x = premises[k0 + i]
        grade(x, bells, owner, grades, logs)
        share(grades, rules, shares)
        blended = fuzzy_tick(phi, consequents, shares, outputs)
        y = scale * blended
        past[now + i] = y
        if not low <= y <= high:
            return i
        if len(slopes) > 0:
            row = slopes[now + i]
            rest = row[consequents.size :]
            _consequent_slopes(phi, consequents, shares, scale, past_lags, past_spreads, row, gains)
            _premise_slopes(x, bells, owner, rules, grades, logs, shares, outputs, blended, scale, rest)
            propagate(slopes, now + i, past_lags, gains)
    return n


register(FuzzyArrays, lambda arrays: arrays.consequents.size + arrays.bells.size, _run_block)
