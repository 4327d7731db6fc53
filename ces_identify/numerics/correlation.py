"""Correlation of sampled sequences with gaps: no product is taken across a gap.

Sequences are arrays (n,) of concatenated runs; `runs` (r, 2) are the [start, stop) of each.
"""

from __future__ import annotations

import math

import numpy as np

from ces_identify.numerics.arrays import F, I, Mask

INSIGNIFICANT_IN_A_ROW = 5  # lags: K_N of Politis & White
FLAT = 0.5  # share of the flat-top window that is flat


def find_runs(mask: Mask, segments: I) -> I:
    """Return the runs (r, 2) of the ticks where `mask` (m,) is true, as indices among these ticks."""
    starts = np.zeros(len(mask), bool)
    starts[segments[:, 0]] = True
    starts[1:] |= ~mask[:-1]
    first = np.flatnonzero(starts[mask])
    return np.stack([first, np.append(first[1:], int(mask.sum()))], axis=1).astype(np.int64)


def covariance(x: F, y: F, runs: I, max_lag: int) -> tuple[F, F]:
    """Return the sum of x(k) y(k + lag) over the pairs inside runs, and the number of pairs.

    Both have shape (max_lag + 1,), for lags 0 to `max_lag`. The means must be subtracted before.
    """
    sums, pairs = np.zeros(max_lag + 1), np.zeros(max_lag + 1)
    for start, stop in runs:
        n = int(stop - start)
        size = 1 << (n + max_lag).bit_length()
        first = np.fft.rfft(x[start:stop], size)
        spectrum = np.conj(first) * (first if y is x else np.fft.rfft(y[start:stop], size))
        lags = min(max_lag, n - 1) + 1
        sums[:lags] += np.fft.irfft(spectrum, size)[:lags]
        pairs += np.maximum(n - np.arange(max_lag + 1), 0)
    return sums, pairs


def autocorrelation(x: F, runs: I, max_lag: int) -> F:
    """Return the correlation (max_lag + 1,) of x with itself at lags 0 to `max_lag`; 1 at lag 0."""
    centred = x - x.mean()
    sums, _ = covariance(centred, centred, runs, max_lag)
    return np.asarray(sums / sums[0])


def longest_memory(n: int, runs: I) -> int:
    """Return the largest possible result of `memory` for n ticks in `runs`."""
    return max(1, min(round(2.0 * math.sqrt(n)), int((runs[:, 1] - runs[:, 0]).max()) - 1))


def memory(rho: F, n: int, max_lag: int) -> int:
    """Return the lag, at most `max_lag`, beyond which the autocorrelation `rho` of n ticks is insignificant.

    The rule of Politis & White (2004, sec. 3.2): the smallest lag after which INSIGNIFICANT_IN_A_ROW correlations are
    below 2 sqrt(log10(n) / n). `rho` must have that many lags beyond `max_lag`.
    """
    small = np.abs(rho[1 : max_lag + 1 + INSIGNIFICANT_IN_A_ROW]) < 2.0 * math.sqrt(math.log10(n) / n)
    in_a_row = np.convolve(small, np.ones(INSIGNIFICANT_IN_A_ROW), "valid") >= INSIGNIFICANT_IN_A_ROW - 0.5
    return int(np.argmax(in_a_row)) if in_a_row.any() else max_lag


def flat_top(max_lag: int) -> F:
    """Return the window (max_lag + 1,) of Politis & Romano (1995): 1 up to FLAT of `max_lag`, then falling to 0."""
    share = np.arange(max_lag + 1) / max(max_lag, 1)
    return np.asarray(np.clip((1.0 - share) / (1.0 - FLAT), 0.0, 1.0))
