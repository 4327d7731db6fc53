"""Kernels of neuro-fuzzy models: shares of the rules, the free run, and its sensitivities to every parameter.

`consequents` (rules, 1 + R) hold each rule's constant and linear part over R regressors; `bells` (memberships, 3) the
centre, logarithm of the width and logarithm of the slope of each membership; `owner` (memberships,) the premise (a
column of `premises`, (ticks, premises)) it is of; `rules` (rules, premises) the membership of each premise. A parameter
vector is `consequents`, then `bells`, row by row. The rest is as in network_kernels.py. Slow readable twin:
`ces_observer.structures.fuzzy.FuzzyRun`.
"""

from __future__ import annotations

from math import exp, inf, log

import numpy as np
from numba import njit

from ces_identify.numerics.normal_matrix import BLOCK, F, I, accumulate, deepest, mirror, propagate


@njit(cache=True, nogil=True)
def grade(x: F, bells: F, owner: I, grades: F, logs: F) -> None:
    """Fill `grades` (memberships,) with the membership of one tick's premises `x` (premises,).

    `logs` (memberships,) becomes the logarithm of the distance from the centre in widths.
    """
    for m in range(len(owner)):
        distance = abs(x[owner[m]] - bells[m, 0])
        if distance == 0.0:
            logs[m], grades[m] = 0.0, 1.0
        else:
            logs[m] = log(distance) - bells[m, 1]
            grades[m] = 1.0 / (1.0 + exp(2.0 * exp(bells[m, 2]) * logs[m]))


@njit(cache=True, nogil=True)
def share(grades: F, rules: I, shares: F) -> None:
    """Fill `shares` (rules,) with each rule's firing over the sum of all."""
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
    """Return the scaled output at the regressors `phi`; fills `outputs` (rules,) with each rule's own."""
    total = 0.0
    for r in range(len(shares)):
        y = consequents[r, 0]
        for j in range(len(phi)):
            y += consequents[r, 1 + j] * phi[j]
        outputs[r] = y
        total += shares[r] * y
    return total


@njit(cache=True, nogil=True)
def fuzzy_free_run(
    values: F,
    past_lags: I,
    past_means: F,
    past_spreads: F,
    segments: I,
    scale: float,
    premises: F,
    owner: I,
    rules: I,
    consequents: F,
    bells: F,
    low: float,
    high: float,
) -> tuple[F, int]:
    """Simulate every segment from its own past forces.

    Returns force (ticks,) [N], NaN from where it left [low, high] to the end of that segment, and the first such
    tick, or -1.
    """
    ticks, width = values.shape
    force = np.zeros(ticks)
    phi = np.empty(width)
    grades, logs = np.empty(len(owner)), np.empty(len(owner))
    shares, outputs = np.empty(len(rules)), np.empty(len(rules))
    first = -1
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        for k in range(start, stop):
            for j in range(width):
                phi[j] = values[k, j]
                if past_lags[j] > 0:
                    past = force[k - past_lags[j]] if k - past_lags[j] >= start else 0.0
                    phi[j] = (past - past_means[j]) / past_spreads[j]
            grade(premises[k], bells, owner, grades, logs)
            share(grades, rules, shares)
            force[k] = scale * fuzzy_tick(phi, consequents, shares, outputs)
            if not low <= force[k] <= high:
                force[k:stop] = np.nan
                first = k if first < 0 else first
                break
    return force, first


@njit(cache=True, nogil=True)
def fuzzy_normal_equations(
    values: F,
    past_lags: I,
    past_means: F,
    past_spreads: F,
    segments: I,
    scale: float,
    premises: F,
    owner: I,
    rules: I,
    consequents: F,
    bells: F,
    low: float,
    high: float,
    measured: F,
    weights: F,
    most: float,
) -> tuple[float, F, F]:
    """Return the weighted squared error of the free run, its Gauss-Newton matrix and (descending) gradient.

    The error is infinite, and the rest unfinished, if the force leaves [low, high] or the error exceeds `most`.
    """
    width = values.shape[1]
    n_params = consequents.size + bells.size
    depth = deepest(past_lags)
    matrix = np.zeros((n_params, n_params))
    gradient = np.zeros(n_params)
    past = np.empty(depth + BLOCK)
    slopes = np.empty((depth + BLOCK, n_params))
    errors = np.empty(BLOCK)
    phi, gains = np.empty(width), np.zeros(width)
    grades, logs = np.empty(len(owner)), np.empty(len(owner))
    shares, outputs = np.empty(len(rules)), np.empty(len(rules))
    total = 0.0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            n = min(k0 + BLOCK, stop) - k0
            for i in range(n):
                for j in range(width):
                    phi[j] = values[k0 + i, j]
                    if past_lags[j] > 0:
                        phi[j] = (past[depth + i - past_lags[j]] - past_means[j]) / past_spreads[j]
                grade(premises[k0 + i], bells, owner, grades, logs)
                share(grades, rules, shares)
                blended = fuzzy_tick(phi, consequents, shares, outputs)
                y = scale * blended
                if not low <= y <= high:
                    return inf, matrix, gradient
                past[depth + i] = y
                errors[i] = measured[k0 + i] - y
                row = slopes[depth + i]
                _consequent_slopes(phi, consequents, shares, scale, past_lags, past_spreads, row, gains)
                _premise_slopes(
                    premises[k0 + i],
                    bells,
                    owner,
                    rules,
                    grades,
                    logs,
                    shares,
                    outputs,
                    blended,
                    scale,
                    row[consequents.size :],
                )
                propagate(slopes, depth + i, past_lags, gains)
            total += accumulate(matrix, gradient, slopes[depth : depth + n], errors[:n], weights[k0 : k0 + n])
            if total > most:
                return inf, matrix, gradient
            past[:depth] = past[n : n + depth].copy()
            slopes[:depth] = slopes[n : n + depth].copy()
    mirror(matrix)
    return total, matrix, gradient


@njit(cache=True, nogil=True)
def _consequent_slopes(
    phi: F, consequents: F, shares: F, scale: float, past_lags: I, past_spreads: F, row: F, gains: F
) -> None:
    """Fill the consequents' part of `row`, and `gains` with the derivative of the force by the past forces."""
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
    x: F,
    bells: F,
    owner: I,
    rules: I,
    grades: F,
    logs: F,
    shares: F,
    outputs: F,
    blended: float,
    scale: float,
    row: F,
) -> None:
    """Fill `row` (3 memberships,) with the derivative of one tick's force by centre, log width and log slope."""
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
