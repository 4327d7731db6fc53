"""Kernels of simulation-error fitting: the free run with its sensitivities, and the normal equations they make.

The free run y(k) = sum_t c_t U_t(k) y(k - j_t), without the past force for terms of the inputs alone, has the
sensitivities s_t = dy/dc_t. They obey the same recursion, driven by the term itself:
s_t(k) = U_t(k) y(k - j_t) + sum_r c_r U_r(k) s_t(k - j_r), r over the terms with a past force (Ljung, System
Identification, 2nd ed., sec. 10.3). Arrays are those of kernels.py.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ces_identify.kernels import BLOCK, F, I, _add_product


@njit(cache=True, nogil=True)
def normal_equations(
    powers: F,
    segments: I,
    weights: F,
    measured: F,
    columns: I,
    lags: I,
    counts: I,
    outputs: I,
    coefficients: F,
    low: float,
    high: float,
) -> tuple[float, F, F]:
    """Return the weighted squared error of the free run, its Gauss-Newton matrix (terms, terms) and gradient (terms,).

    The error is infinite if the force leaves [low, high]; matrix and gradient are then unfinished.
    """
    n_terms = len(coefficients)
    depth = 1
    for t in range(n_terms):
        depth = max(depth, outputs[t])
    matrix = np.zeros((n_terms, n_terms))
    gradient = np.zeros(n_terms)
    product = np.empty(BLOCK)
    terms = np.empty((BLOCK, n_terms))
    past = np.empty(depth + BLOCK)
    slopes = np.empty((depth + BLOCK, n_terms))
    total = 0.0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        past[:depth] = 0.0
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            k1 = min(k0 + BLOCK, stop)
            n = k1 - k0
            for t in range(n_terms):
                product[:n] = 0.0
                _add_product(powers, columns[t], lags[t], counts[t], 1.0, start, k0, k1, product)
                for i in range(n):
                    terms[i, t] = product[i]
            for i in range(n):
                _advance(terms[i], outputs, coefficients, past, slopes, depth + i)
                if not low <= past[depth + i] <= high:
                    return np.inf, matrix, gradient
            for i in range(n):
                w = weights[k0 + i]
                if w > 0.0:
                    error = measured[k0 + i] - past[depth + i]
                    total += w * error * error
                    _accumulate(matrix, gradient, slopes[depth + i], w, error)
            past[:depth] = past[n : n + depth].copy()
            slopes[:depth] = slopes[n : n + depth].copy()
    for i in range(n_terms):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return total, matrix, gradient


@njit(cache=True, nogil=True, inline="always")
def _advance(inputs: F, outputs: I, coefficients: F, past: F, slopes: F, k: int) -> None:
    """One tick of the free run and of its sensitivities."""
    row = slopes[k]
    y = 0.0
    for t in range(len(outputs)):
        row[t] = inputs[t]
        if outputs[t] > 0:
            row[t] *= past[k - outputs[t]]
        y += coefficients[t] * row[t]
    past[k] = y
    for r in range(len(outputs)):
        if outputs[r] > 0:
            gain = coefficients[r] * inputs[r]
            earlier = slopes[k - outputs[r]]
            for t in range(len(outputs)):
                row[t] += gain * earlier[t]


@njit(cache=True, nogil=True, inline="always")
def _accumulate(matrix: F, gradient: F, row: F, weight: float, error: float) -> None:
    """Add one tick to the lower triangle and the gradient."""
    for i in range(len(row)):
        share = weight * row[i]
        gradient[i] += share * error
        for j in range(i + 1):
            matrix[i, j] += share * row[j]


@njit(cache=True, nogil=True)
def output_gains(
    powers: F, segments: I, columns: I, lags: I, counts: I, outputs: I, coefficients: F, output_lags: I
) -> F:
    """Return the sum of coefficient times inputs of the terms of each output lag, shape (output lags, ticks)."""
    gains = np.zeros((len(output_lags), powers.shape[1]))
    for j in range(len(output_lags)):
        for t in range(len(outputs)):
            if outputs[t] != output_lags[j]:
                continue
            for s in range(len(segments)):
                start, stop = segments[s, 0], segments[s, 1]
                for k0 in range(start, stop, BLOCK):
                    k1 = min(k0 + BLOCK, stop)
                    _add_product(
                        powers, columns[t], lags[t], counts[t], coefficients[t], start, k0, k1, gains[j, k0:k1]
                    )
    return gains


@njit(cache=True, nogil=True)
def sensitivity(
    powers: F,
    segments: I,
    force: F,
    columns: I,
    lags: I,
    count: int,
    output: int,
    gains: F,
    output_lags: I,
    slope: F,
) -> None:
    """Fill `slope` (ticks,) with dy/dc of one term, in the model or not, along the free run `force` (ticks,)."""
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        slope[start:stop] = 0.0
        for k0 in range(start, stop, BLOCK):
            k1 = min(k0 + BLOCK, stop)
            _add_product(powers, columns, lags, count, 1.0, start, k0, k1, slope[k0:k1])
        for k in range(start, stop):
            if output > 0:
                slope[k] *= force[k - output] if k - output >= start else 0.0
            for j in range(len(output_lags)):
                back = k - output_lags[j]
                if back >= start:
                    slope[k] += gains[j, k] * slope[back]


@njit(cache=True, nogil=True)
def candidate_products(
    powers: F,
    segments: I,
    force: F,
    columns: I,
    lags: I,
    counts: I,
    outputs: I,
    chosen: I,
    candidates: I,
    gains: F,
    output_lags: I,
    weights: F,
    error: F,
    ticks: I,
) -> tuple[F, F, F, F]:
    """Return the weighted inner products, over `ticks` alone, that tell what each candidate would gain.

    Sensitivities of the chosen terms with each other (chosen, chosen) and with the error (chosen,); of each candidate
    with the chosen terms (candidates, chosen); and (candidates, 2) with itself and with the error.
    """
    n, m = len(chosen), len(ticks)
    slope = np.empty(powers.shape[1])
    rows = np.empty((n, m))
    matrix, gradient = np.zeros((n, n)), np.zeros(n)
    cross, own = np.zeros((len(candidates), n)), np.zeros((len(candidates), 2))
    for i in range(n):
        c = chosen[i]
        sensitivity(powers, segments, force, columns[c], lags[c], counts[c], outputs[c], gains, output_lags, slope)
        for k in range(m):
            rows[i, k] = slope[ticks[k]]
        for k in range(m):
            gradient[i] += weights[ticks[k]] * rows[i, k] * error[ticks[k]]
        for j in range(i + 1):
            for k in range(m):
                matrix[i, j] += weights[ticks[k]] * rows[i, k] * rows[j, k]
            matrix[j, i] = matrix[i, j]
    weighted = np.empty(m)
    for i in range(len(candidates)):
        c = candidates[i]
        sensitivity(powers, segments, force, columns[c], lags[c], counts[c], outputs[c], gains, output_lags, slope)
        for k in range(m):
            weighted[k] = weights[ticks[k]] * slope[ticks[k]]
            own[i, 0] += weighted[k] * slope[ticks[k]]
            own[i, 1] += weighted[k] * error[ticks[k]]
        for j in range(n):
            total = 0.0
            for k in range(m):
                total += weighted[k] * rows[j, k]
            cross[i, j] = total
    return matrix, gradient, cross, own
