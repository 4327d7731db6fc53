"""The numerical kernels: plain loops over arrays, compiled by Numba, each with a slow readable twin in the tests.

`powers` (rows, ticks) is the power table; `segments[s] = (start, stop)` are ticks without a gap. Before a segment's
start the inputs equal those of its first tick and the forces are zero, exactly as in
`ces_observer.structures.polynomial`.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from ces_data.arrays import F, I, Mask
from ces_identify.numerics.core import compile_tick, core_kernel
from ces_observer.tick.polynomial import power_of

BLOCK = 1024  # ticks per pass, which fit into the first-level cache
Bounds = tuple[float, float]  # lowest and highest force of a free run [N]


class TermArrays(NamedTuple):
    """A set of terms: factor f of term t is row `columns[t, f]` of the power table, `lags[t, f]` ticks back.

    `counts[t]` is the number of factors, `outputs[t]` the lag of the past force, 0 if the term has none.
    """

    columns: I
    lags: I
    counts: I
    outputs: I


class ScoredRun(NamedTuple):
    """What the cost of a free run needs besides the terms.

    `weights` (ticks,) is 1 / sum (y - mean y)^2 of the tick's recording where the tick is scored, else 0;
    `recordings[s]` is the index of segment s's recording, ascending.
    """

    powers: F
    segments: I
    recordings: I
    weights: F
    measured: F
    bounds: Bounds


power_value = compile_tick(power_of)


@core_kernel
def power_row(values: F, power: float, signed: bool) -> F:
    """Return |s|^power, or sign(s) |s|^power if `signed`, for each value s."""
    row = np.empty(len(values))
    for k in range(len(values)):
        row[k] = power_value(values[k], power, signed)
    return row


@njit(cache=True, nogil=True)
def _add_product(
    powers: F, terms: TermArrays, term: int, scale: float, start: int, k0: int, k1: int, target: F
) -> None:
    """Add scale times the product of a term's input factors over ticks k0 to k1 to target[: k1 - k0]."""
    columns, lags, count = terms.columns[term], terms.lags[term], terms.counts[term]
    n = k1 - k0
    out = target[:n]
    deepest = 0
    for f in range(count):
        deepest = max(deepest, lags[f])
    if count > 3 or k0 - deepest < start:
        for i in range(n):
            product = scale
            for f in range(count):
                product *= powers[columns[f], max(k0 + i - lags[f], start)]
            out[i] += product
    elif count == 0:
        for i in range(n):
            out[i] += scale
    elif count == 1:
        first = powers[columns[0], k0 - lags[0] : k1 - lags[0]]
        for i in range(n):
            out[i] += scale * first[i]
    elif count == 2:
        first = powers[columns[0], k0 - lags[0] : k1 - lags[0]]
        second = powers[columns[1], k0 - lags[1] : k1 - lags[1]]
        for i in range(n):
            out[i] += scale * first[i] * second[i]
    else:
        first = powers[columns[0], k0 - lags[0] : k1 - lags[0]]
        second = powers[columns[1], k0 - lags[1] : k1 - lags[1]]
        third = powers[columns[2], k0 - lags[2] : k1 - lags[2]]
        for i in range(n):
            out[i] += scale * first[i] * second[i] * third[i]


@njit(cache=True, nogil=True)
def _run_block(
    powers: F, terms: TermArrays, coefficients: F, start: int, k0: int, k1: int, bounds: Bounds, force: F, work: F,
    held: Mask,
) -> int:  # fmt: skip
    """Free-run ticks k0 to k1 of a segment that starts at `start`; returns the tick at which it ended, or k1.

    A force out of bounds ends it if `held` is empty; else it is held at its bound and marked there. One that is not
    finite always does. `work` (1 + output lags, BLOCK) receives the inputs' part of the force and the gain of each
    distinct output lag.
    """
    n = k1 - k0
    inputs = work[0]
    outputs = terms.outputs
    low, high = bounds
    used = np.empty(len(outputs), np.int64)
    n_used = 0
    inputs[:n] = 0.0
    for t in range(len(coefficients)):
        slot = -1
        if outputs[t] > 0:
            slot = 0
            while slot < n_used and used[slot] != outputs[t]:
                slot += 1
            if slot == n_used:
                used[slot] = outputs[t]
                n_used += 1
                work[1 + slot, :n] = 0.0
        _add_product(powers, terms, t, coefficients[t], start, k0, k1, work[1 + slot])
    single_lag = n_used == 1 and k0 - used[0] >= start
    if single_lag and _recursion_of_one(inputs[:n], work[1, :n], force[k0 - used[0] : k1], used[0], low, high):
        return k1
    for i in range(n):
        y = inputs[i]
        k = k0 + i
        for slot in range(n_used):
            back = k - used[slot]
            if back >= start:
                y += work[1 + slot, i] * force[back]
        if not low <= y <= high:
            if len(held) == 0 or not isfinite(y):
                return k
            held[k] = True
            y = min(max(y, low), high)
        force[k] = y
    return k1


@njit(cache=True, nogil=True)
def _recursion_of_one(inputs: F, gain: F, force: F, lag: int, low: float, high: float) -> bool:
    """Run the recursion with one output lag, `force` from `lag` ticks before the block; return if it kept to bounds."""
    bounded = True
    for i in range(len(inputs)):
        y = inputs[i] + gain[i] * force[i]
        force[i + lag] = y
        bounded &= low <= y <= high
    return bounded


@njit(cache=True, nogil=True)
def free_run(powers: F, segments: I, terms: TermArrays, coefficients: F, bounds: Bounds) -> tuple[F, Mask]:
    """Simulate every segment from its own past forces, which are held in `bounds`.

    Returns force (ticks,) [N], NaN from where it is not finite to the end of that segment, and where it was held.
    """
    force = np.zeros(powers.shape[1])
    held = np.zeros(len(force), np.bool_)
    work = np.empty((1 + len(coefficients), BLOCK))
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        k0 = start
        while k0 < stop:
            k1 = min(k0 + BLOCK, stop)
            end = _run_block(powers, terms, coefficients, start, k0, k1, bounds, force, work, held)
            if end < k1:
                force[end:stop] = np.nan
                break
            k0 = k1
    return force, held


@njit(cache=True, nogil=True)
def free_run_cost(run: ScoredRun, terms: TermArrays, coefficients: F, best: float, work: F, force: F) -> float:
    """Return the mean over recordings of the free-run cost J [%], or infinity as soon as it must exceed `best`."""
    powers, segments, recordings, weights, measured, bounds = run
    n_recordings = recordings[-1] + 1
    never_held = np.zeros(0, np.bool_)
    done = 0.0
    share = 0.0
    for s in range(len(segments)):
        if s > 0 and recordings[s] != recordings[s - 1]:
            done += sqrt(share)
            share = 0.0
        start, stop = segments[s, 0], segments[s, 1]
        k0 = start
        while k0 < stop:
            k1 = min(k0 + BLOCK, stop)
            end = _run_block(powers, terms, coefficients, start, k0, k1, bounds, force, work, never_held)
            if end < k1:
                return inf
            for k in range(k0, k1):
                error = force[k] - measured[k]
                share += weights[k] * error * error
            if 100.0 * (done + sqrt(share)) > best * n_recordings:
                return inf
            k0 = k1
    cost: float = 100.0 * (done + sqrt(share)) / n_recordings
    return cost


@njit(cache=True, nogil=True)
def solve_normal(gram: F, chosen: I, ridge: float) -> tuple[F, bool]:
    """Solve least squares of the last column of `gram` on the `chosen` ones, by a scaled Cholesky factorisation.

    Returns the coefficients and whether the columns were independent (pivots above `ridge` after scaling).
    """
    n = len(chosen)
    y = gram.shape[0] - 1
    scale = np.empty(n)
    for i in range(n):
        d = gram[chosen[i], chosen[i]]
        if d <= 0.0:
            return np.zeros(n), False
        scale[i] = 1.0 / sqrt(d)
    factor = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = gram[chosen[i], chosen[j]] * scale[i] * scale[j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if total <= ridge:
                    return np.zeros(n), False
                factor[i, i] = sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    solution = np.empty(n)
    for i in range(n):
        total = gram[chosen[i], y] * scale[i]
        for k in range(i):
            total -= factor[i, k] * solution[k]
        solution[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * solution[k]
        solution[i] = total / factor[i, i]
    for i in range(n):
        solution[i] *= scale[i]
    return solution, True


@njit(cache=True, nogil=True)
def regressor_columns(powers: F, measured: F, segments: I, terms: TermArrays, k0: int, k1: int, segment: int) -> F:
    """Return the regressors (terms, k1 - k0) over ticks of one segment, with the past forces of `measured`."""
    n = k1 - k0
    start = segments[segment, 0]
    outputs = terms.outputs
    out = np.zeros((len(outputs), n))
    for t in range(len(outputs)):
        _add_product(powers, terms, t, 1.0, start, k0, k1, out[t])
        if outputs[t] > 0:
            for i in range(n):
                back = k0 + i - outputs[t]
                out[t, i] *= measured[back] if back >= start else 0.0
    return out


@njit(cache=True, nogil=True)
def probed_gain(probes: F, outputs: I, coefficients: F) -> float:
    """Return the largest sum over output lags of |sum of coefficient * probe| over the probed inputs.

    `probes` (terms, points) holds the product of each term's input factors at each point, for terms with a past force.
    """
    largest = 0.0
    for point in range(probes.shape[1]):
        total = 0.0
        for t in range(len(outputs)):
            if outputs[t] == 0:
                continue
            first = True
            for r in range(t):
                first &= outputs[r] != outputs[t]
            if first:
                share = 0.0
                for r in range(t, len(outputs)):
                    if outputs[r] == outputs[t]:
                        share += coefficients[r] * probes[r, point]
                total += abs(share)
        largest = max(largest, total)
    return largest


@njit(cache=True, nogil=True)
def first_better(
    gram: F, chosen: I, trial: I, run: ScoredRun, terms: TermArrays, best: float, ridge: float, drop: bool
) -> tuple[int, float, F]:
    """Try each candidate of `trial` added to (or, with `drop`, each place of `trial` removed from) `chosen`.

    Fits by least squares on `gram`, evaluates the free run, and stops at the first cost below `best`. Returns the place
    in `trial` (-1 if none was better), the cost and the coefficients.
    """
    n = len(chosen) - 1 if drop else len(chosen) + 1
    subset = np.empty(n, np.int64)
    work = np.empty((1 + n, BLOCK))
    force = np.empty(run.powers.shape[1])
    for place in range(len(trial)):
        if drop:
            k = 0
            for i in range(len(chosen)):
                if i != trial[place]:
                    subset[k] = chosen[i]
                    k += 1
        else:
            subset[: n - 1] = chosen
            subset[n - 1] = trial[place]
        coefficients, independent = solve_normal(gram, subset, ridge)
        if not independent:
            continue
        arrays = TermArrays(terms.columns[subset], terms.lags[subset], terms.counts[subset], terms.outputs[subset])
        cost = free_run_cost(run, arrays, coefficients, best, work, force)
        if cost < best:
            return place, cost, coefficients
    return -1, best, np.empty(0)
