"""The fit of a model's coefficients: Levenberg-Marquardt on the free-run error, with a penalty that keeps it stable.

The free run y(k) = sum_t c_t U_t(k) y(k - j_t), without the past force in terms of inputs only, has the sensitivities
s_t = dy/dc_t. They obey the same recursion, driven by the term itself:
s_t(k) = U_t(k) y(k - j_t) + sum_j a_j(k) s_t(k - j), where a_j(k) sums c_r U_r(k) over the terms r with the past force
of lag j (Ljung, System Identification, 2nd ed., sec. 10.3). Arrays are those of kernels.py. The penalty is on the gain
at probed inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np
from numba import njit

from ces_data.arrays import F, I, Mask
from ces_identify.numerics import kernels
from ces_identify.numerics.kernels import Bounds, TermArrays, _add_product
from ces_identify.numerics.least_squares import (
    BLOCK,
    NO_MODEL,
    Damping,
    NormalEquations,
    accumulate,
    improve,
    limit_gains,
    longest_lag,
    mirror,
)
from ces_identify.numerics.search import SearchResult
from ces_identify.polynomial.problem import Problem

ROOM = 0.005  # the penalty begins so far below the greatest gain allowed
PENALTY = 1e3  # of a squared excess of gain, in units of the squared error at the start
STOP_DECREASE = 2e-4  # relative decrease at which to stop
DAMPING = Damping(1e-4, 1e-9, np.inf, 8.0, 8.0, tries=8)


@dataclass(frozen=True)
class FreeRunFit:
    """Coefficients (terms,), their weighted squared error (infinite if the run diverges) and Gauss-Newton matrix."""

    coefficients: F
    error: float
    matrix: F


def fit_free_run(problem: Problem, chosen: I, coefficients: F, weights: F, iterations: int) -> FreeRunFit:
    """Return the coefficients after at most `iterations` steps that lower the weighted free-run error.

    If the problem requires stable models and the first one is stable, so is every step; its probed gain may reach the
    mean of the greatest gain allowed and 1.
    """
    arrays, probes = problem.layout.subset(chosen), problem.probes[chosen]

    def equations(c: F) -> NormalEquations:
        if kernels.probed_gain(probes, arrays.outputs, c) >= 0.5 * (1.0 + problem.max_gain):
            return NO_MODEL
        data = problem.powers, problem.segments, weights, problem.measured
        return NormalEquations(*normal_equations(*data, arrays, c, problem.force_envelope))

    start, penalties = equations(coefficients), []
    if iterations == 0 or not np.isfinite(start.error):
        return FreeRunFit(coefficients, start.error, start.matrix)
    if np.isfinite(problem.max_gain) and (arrays.outputs > 0).any():
        by_lag = [np.where((arrays.outputs == lag)[:, None], probes, 0.0) for lag in np.unique(arrays.outputs) if lag]
        how = partial(_probed_gains, by_lag), partial(_probed_slopes, by_lag)
        penalties = [limit_gains(*how, problem.max_gain - ROOM, PENALTY * start.error)]
    points = improve(lambda c, _: start if c is coefficients else equations(c), coefficients, penalties, DAMPING)
    point = next(points)
    for better in islice(points, iterations):
        settled = point.value - better.value < STOP_DECREASE * point.value
        point = better
        if settled:
            break
    return FreeRunFit(point.params, point.data.error, point.data.matrix)


def _probed_gains(by_lag: Sequence[F], coefficients: F) -> F:
    """Return the gain of the past forces at each probed input (points,), from the probes of each lag."""
    return np.asarray(sum(np.abs(coefficients @ probes) for probes in by_lag))


def _probed_slopes(by_lag: Sequence[F], coefficients: F, points: Mask) -> F:
    """Return the derivatives of the gains at some points (points, terms) by the coefficients."""
    chosen = [probes[:, points] for probes in by_lag]
    return np.asarray(sum(probes * np.sign(coefficients @ probes) for probes in chosen)).T


ITERATIONS = 20  # of the last fit, to all ticks


def refit_coefficients(problem: Problem, result: SearchResult) -> F:
    """Return coefficients fitted to all identification ticks, those of `result` if that raises the selection cost."""
    fit = fit_free_run(problem, result.chosen, result.coefficients, problem.everything, ITERATIONS)
    harmless = np.isfinite(fit.error) and problem.selection_cost(result.chosen, fit.coefficients) <= result.cost
    return fit.coefficients if harmless else result.coefficients


LANES = 32  # candidates whose sensitivities run side by side


@njit(cache=True, nogil=True)
def normal_equations(
    powers: F, segments: I, weights: F, measured: F, terms: TermArrays, coefficients: F, bounds: Bounds
) -> tuple[float, F, F]:
    """Return the weighted squared error of the free run, its Gauss-Newton matrix (terms, terms) and gradient (terms,).

    The error is infinite if the force leaves `bounds`; matrix and gradient are then unfinished.
    """
    n_terms, outputs = len(coefficients), terms.outputs
    output_lags = _distinct(outputs)
    depth = longest_lag(output_lags)
    matrix, gradient = np.zeros((n_terms, n_terms)), np.zeros(n_terms)
    values, inputs, gains = np.empty((n_terms, BLOCK)), np.empty(BLOCK), np.empty((BLOCK, len(output_lags)))
    past, slopes = np.empty(depth + BLOCK), np.empty((depth + BLOCK, n_terms))
    errors = np.empty(BLOCK)
    total = 0.0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            k1 = min(k0 + BLOCK, stop)
            n = k1 - k0
            for t in range(n_terms):
                values[t, :n] = 0.0
                _add_product(powers, terms, t, 1.0, start, k0, k1, values[t])
            _sums(values, outputs, output_lags, coefficients, inputs[:n], gains[:n])
            if not _advance(inputs[:n], gains, output_lags, past, depth, bounds):
                return np.inf, matrix, gradient
            for t in range(n_terms):
                for i in range(n if outputs[t] > 0 else 0):
                    values[t, i] *= past[depth + i - outputs[t]]
            _run_slopes(values, n, output_lags, gains[:n], slopes, depth)
            for i in range(n):
                errors[i] = measured[k0 + i] - past[depth + i]
            total += accumulate(matrix, gradient, slopes[depth : depth + n], errors[:n], weights[k0:k1])
            for i in range(depth):
                past[i] = past[n + i]
            _keep_last(slopes, n, depth)
    mirror(matrix)
    return total, matrix, gradient


@njit(cache=True, nogil=True)
def _distinct(outputs: I) -> I:
    """Return the output lags in use, ascending; loops, which compile in half the time of np.unique."""
    lags, count = np.empty(len(outputs), np.int64), 0
    for lag in outputs:
        place = count
        while place > 0 and lags[place - 1] > lag:
            place -= 1
        if lag <= 0 or (place > 0 and lags[place - 1] == lag):
            continue
        for i in range(count, place, -1):
            lags[i] = lags[i - 1]
        lags[place] = lag
        count += 1
    return lags[:count]


@njit(cache=True, nogil=True)
def _sums(terms: F, outputs: I, output_lags: I, coefficients: F, inputs: F, gains: F) -> None:
    """Fill the inputs' part of the force (ticks,) and the gains of the past forces (ticks, output lags)."""
    inputs[:] = 0.0
    gains[:] = 0.0
    for t in range(len(outputs)):
        if outputs[t] == 0:
            for i in range(len(inputs)):
                inputs[i] += coefficients[t] * terms[t, i]
        for j in range(len(output_lags)):
            if output_lags[j] == outputs[t]:
                for i in range(len(inputs)):
                    gains[i, j] += coefficients[t] * terms[t, i]


@njit(cache=True, nogil=True)
def _advance(inputs: F, gains: F, output_lags: I, past: F, depth: int, bounds: Bounds) -> bool:
    """Continue the force after the first `depth` ticks of `past`; False once it leaves `bounds`."""
    low, high = bounds
    for i in range(len(inputs)):
        y = inputs[i]
        for j in range(len(output_lags)):
            y += gains[i, j] * past[depth + i - output_lags[j]]
        past[depth + i] = y
        if not low <= y <= high:
            return False
    return True


@njit(cache=True, nogil=True)
def _run_slopes(terms: F, n: int, output_lags: I, gains: F, slopes: F, depth: int) -> None:
    """Continue the sensitivities (depth + ticks, terms) for n ticks, driven by `terms` (terms, ticks)."""
    for i in range(n):
        for t in range(terms.shape[0]):
            slopes[depth + i, t] = terms[t, i]
        for j in range(len(output_lags)):
            gain, back = gains[i, j], depth + i - output_lags[j]
            for t in range(terms.shape[0]):
                slopes[depth + i, t] += gain * slopes[back, t]


@njit(cache=True, nogil=True)
def output_gains(powers: F, segments: I, terms: TermArrays, coefficients: F, output_lags: I) -> F:
    """Return the sum of coefficient times inputs of the terms of each output lag, shape (ticks, output lags)."""
    gains = np.zeros((powers.shape[1], len(output_lags)))
    product = np.empty(BLOCK)
    for j in range(len(output_lags)):
        for t in range(len(terms.outputs)):
            if terms.outputs[t] != output_lags[j]:
                continue
            for s in range(len(segments)):
                start, stop = segments[s, 0], segments[s, 1]
                for k0 in range(start, stop, BLOCK):
                    k1 = min(k0 + BLOCK, stop)
                    product[: k1 - k0] = 0.0
                    _add_product(powers, terms, t, coefficients[t], start, k0, k1, product)
                    for k in range(k0, k1):
                        gains[k, j] += product[k - k0]
    return gains


@njit(cache=True, nogil=True)
def sensitivities(powers: F, segments: I, force: F, terms: TermArrays, which: I, gains: F, lags: I, weights: F) -> F:
    """Return dy/dc (weighted ticks, terms) of the terms at `which`, in the model or not; `force` is the free run."""
    n_terms, depth = len(which), longest_lag(lags)
    used = 0
    for weight in weights:
        used += weight > 0.0
    out = np.empty((used, n_terms))
    values, slopes = np.empty((n_terms, BLOCK)), np.empty((depth + BLOCK, n_terms))
    row = 0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            k1 = min(k0 + BLOCK, stop)
            n = k1 - k0
            for t in range(n_terms):
                values[t, :n] = 0.0
                _add_product(powers, terms, which[t], 1.0, start, k0, k1, values[t])
                lag = terms.outputs[which[t]]
                if lag > 0:
                    for k in range(k0, k1):
                        values[t, k - k0] *= force[k - lag] if k - lag >= start else 0.0
            _run_slopes(values, n, lags, gains[k0:k1], slopes, depth)
            for i in range(n):
                if weights[k0 + i] > 0.0:
                    for t in range(n_terms):
                        out[row, t] = slopes[depth + i, t]
                    row += 1
            _keep_last(slopes, n, depth)
    return out


@njit(cache=True, nogil=True)
def _keep_last(slopes: F, n: int, depth: int) -> None:
    """Move the last `depth` rows of (depth + n, terms) to the front; a loop compiles faster than a copied slice."""
    for i in range(depth):
        for t in range(slopes.shape[1]):
            slopes[i, t] = slopes[n + i, t]


@njit(cache=True, nogil=True)
def candidate_products(
    powers: F, segments: I, force: F, terms: TermArrays, chosen: I, tried: I, gains: F, lags: I, weights: F, error: F
) -> tuple[F, F, F, F]:
    """Return the weighted inner products, over the ticks with a weight above zero, that give each candidate's gain.

    Sensitivities of the chosen terms with each other (chosen, chosen) and with the error (chosen,); of each candidate
    with the chosen terms (tried, chosen); and (tried, 2) with itself and with the error.
    """
    n = len(chosen)
    run = (powers, segments, force, terms)
    rows = sensitivities(*run, chosen, gains, lags, weights)
    w, e, used = np.empty(len(rows)), np.empty(len(rows)), 0
    for k in range(len(weights)):  # a loop compiles faster than an index by truth values
        if weights[k] > 0.0:
            w[used], e[used] = weights[k], error[k]
            used += 1
    matrix, gradient = np.zeros((n, n)), np.zeros(n)
    cross, own = np.zeros((len(tried), n)), np.zeros((len(tried), 2))
    accumulate(matrix, gradient, rows, e, w)
    mirror(matrix)
    for first in range(0, len(tried), LANES):
        last = min(first + LANES, len(tried))
        slopes = sensitivities(*run, tried[first:last], gains, lags, weights)
        for k in range(len(w)):
            for c in range(last - first):
                share = w[k] * slopes[k, c]
                own[first + c, 0] += share * slopes[k, c]
                own[first + c, 1] += share * e[k]
                for j in range(n):
                    cross[first + c, j] += share * rows[k, j]
    return matrix, gradient, cross, own
