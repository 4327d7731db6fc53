"""Kernels of simulation-error fitting: the free run with its sensitivities, and the normal equations they make.

The free run y(k) = sum_t c_t U_t(k) y(k - j_t), without the past force for terms of the inputs alone, has the
sensitivities s_t = dy/dc_t. They obey the same recursion, driven by the term itself:
s_t(k) = U_t(k) y(k - j_t) + sum_j a_j(k) s_t(k - j), where a_j(k) sums c_r U_r(k) over the terms r with the past force
of lag j (Ljung, System Identification, 2nd ed., sec. 10.3). Arrays are those of kernels.py.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ces_identify.numerics.kernels import F, I, _add_product
from ces_identify.numerics.normal_matrix import BLOCK, accumulate, longest_lag, mirror

LANES = 32  # candidates whose sensitivities run side by side


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
    output_lags = _distinct(outputs)
    depth = longest_lag(output_lags)
    matrix, gradient = np.zeros((n_terms, n_terms)), np.zeros(n_terms)
    terms, inputs, gains = np.empty((n_terms, BLOCK)), np.empty(BLOCK), np.empty((BLOCK, len(output_lags)))
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
                terms[t, :n] = 0.0
                _add_product(powers, columns[t], lags[t], counts[t], 1.0, start, k0, k1, terms[t])
            _sums(terms, outputs, output_lags, coefficients, inputs[:n], gains[:n])
            if not _advance(inputs[:n], gains, output_lags, past, depth, low, high):
                return np.inf, matrix, gradient
            for t in range(n_terms):
                for i in range(n if outputs[t] > 0 else 0):
                    terms[t, i] *= past[depth + i - outputs[t]]
            _run_slopes(terms, n, output_lags, gains[:n], slopes, depth)
            for i in range(n):
                errors[i] = measured[k0 + i] - past[depth + i]
            total += accumulate(matrix, gradient, slopes[depth : depth + n], errors[:n], weights[k0:k1])
            past[:depth] = past[n : n + depth].copy()
            slopes[:depth] = slopes[n : n + depth].copy()
    mirror(matrix)
    return total, matrix, gradient


@njit(cache=True, nogil=True)
def _distinct(outputs: I) -> I:
    """Return the output lags in use, ascending."""
    found = np.unique(outputs)
    return found[found > 0]


@njit(cache=True, nogil=True)
def _sums(terms: F, outputs: I, output_lags: I, coefficients: F, inputs: F, gains: F) -> None:
    """Fill the part of the inputs (ticks,) and what each past force is multiplied by (ticks, output lags)."""
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
def _advance(inputs: F, gains: F, output_lags: I, past: F, depth: int, low: float, high: float) -> bool:
    """Run the force on for some ticks after the first `depth` of `past`; False once it leaves [low, high]."""
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
    """Run the sensitivities (depth + ticks, terms) on for n ticks, driven by `terms` (terms, ticks)."""
    for i in range(n):
        for t in range(terms.shape[0]):
            slopes[depth + i, t] = terms[t, i]
        for j in range(len(output_lags)):
            gain, back = gains[i, j], depth + i - output_lags[j]
            for t in range(terms.shape[0]):
                slopes[depth + i, t] += gain * slopes[back, t]


@njit(cache=True, nogil=True)
def output_gains(
    powers: F, segments: I, columns: I, lags: I, counts: I, outputs: I, coefficients: F, output_lags: I
) -> F:
    """Return the sum of coefficient times inputs of the terms of each output lag, shape (ticks, output lags)."""
    gains = np.zeros((powers.shape[1], len(output_lags)))
    product = np.empty(BLOCK)
    for j in range(len(output_lags)):
        for t in range(len(outputs)):
            if outputs[t] != output_lags[j]:
                continue
            for s in range(len(segments)):
                start, stop = segments[s, 0], segments[s, 1]
                for k0 in range(start, stop, BLOCK):
                    k1 = min(k0 + BLOCK, stop)
                    product[: k1 - k0] = 0.0
                    _add_product(powers, columns[t], lags[t], counts[t], coefficients[t], start, k0, k1, product)
                    for k in range(k0, k1):
                        gains[k, j] += product[k - k0]
    return gains


@njit(cache=True, nogil=True)
def sensitivities(
    powers: F,
    segments: I,
    force: F,
    columns: I,
    lags: I,
    counts: I,
    outputs: I,
    which: I,
    gains: F,
    output_lags: I,
    weights: F,
) -> F:
    """Return dy/dc of the terms at `which`, in the model or not, along the free run `force` (ticks,).

    Shape (ticks of a weight above zero, terms).
    """
    n_terms, depth = len(which), longest_lag(output_lags)
    out = np.empty((np.count_nonzero(weights > 0.0), n_terms))
    terms, slopes = np.empty((n_terms, BLOCK)), np.empty((depth + BLOCK, n_terms))
    kept = 0
    for s in range(len(segments)):
        start, stop = segments[s, 0], segments[s, 1]
        slopes[:depth] = 0.0
        for k0 in range(start, stop, BLOCK):
            k1 = min(k0 + BLOCK, stop)
            n = k1 - k0
            for t in range(n_terms):
                c = which[t]
                terms[t, :n] = 0.0
                _add_product(powers, columns[c], lags[c], counts[c], 1.0, start, k0, k1, terms[t])
                if outputs[c] > 0:
                    for k in range(k0, k1):
                        terms[t, k - k0] *= force[k - outputs[c]] if k - outputs[c] >= start else 0.0
            _run_slopes(terms, n, output_lags, gains[k0:k1], slopes, depth)
            for i in range(n):
                if weights[k0 + i] > 0.0:
                    out[kept] = slopes[depth + i]
                    kept += 1
            slopes[:depth] = slopes[n : n + depth].copy()
    return out


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
) -> tuple[F, F, F, F]:
    """Return the weighted inner products, over the ticks of a weight above zero, that tell what candidates would gain.

    Sensitivities of the chosen terms with each other (chosen, chosen) and with the error (chosen,); of each candidate
    with the chosen terms (candidates, chosen); and (candidates, 2) with itself and with the error.
    """
    used = weights > 0.0
    w, e = weights[used], error[used]
    n = len(chosen)
    run = (powers, segments, force, columns, lags, counts, outputs)
    rows = sensitivities(*run, chosen, gains, output_lags, weights)
    matrix, gradient = np.zeros((n, n)), np.zeros(n)
    cross, own = np.zeros((len(candidates), n)), np.zeros((len(candidates), 2))
    accumulate(matrix, gradient, rows, e, w)
    mirror(matrix)
    for first in range(0, len(candidates), LANES):
        last = min(first + LANES, len(candidates))
        slopes = sensitivities(*run, candidates[first:last], gains, output_lags, weights)
        for k in range(len(w)):
            for c in range(last - first):
                share = w[k] * slopes[k, c]
                own[first + c, 0] += share * slopes[k, c]
                own[first + c, 1] += share * e[k]
                for j in range(n):
                    cross[first + c, j] += share * rows[k, j]
    return matrix, gradient, cross, own
