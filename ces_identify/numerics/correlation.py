"""Correlated sequences: their autocorrelation across gaps, the standard error of their sum; p-values of several tests.

No product is taken across a gap. Sequences are arrays (n,) of concatenated runs; `runs` (r, 2) are the [start, stop) of
each.

The error of a sum is found from its projections on a few slow cosines. Errors of a damper vary with the excitation, the
road or the current, far more slowly than from sample to sample. What is slower than a recording allows to see cannot be
read from it, so a bound on it is assumed: changes with a correlation time of up to SLOWEST_S, or MIN_SHARE of the
recording where that is longer, are always taken to be possible. The method is the equal-weighted cosine test (Lazarus,
Lewis, Stock & Watson, Journal of Business & Economic Statistics 36, 2018), with the correction for a bound on the
persistence of Dou (Quantitative Economics 15, 2024): the squared projections on q cosines are each divided by what they
are for the slowest process allowed, relative to the variance of its sum. Their mean is the variance of the sum, with q
degrees of freedom. For anything faster, the error is too large, never too small; in recordings much longer than
SLOWEST_S by little.

Where the slowest projections stand out even so (F test at ALARM), a bound of ALARM_SHARE of the recording counts.

Several tests have Holm's correction (Scandinavian Journal of Statistics 6, 1979).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import dct
from scipy.linalg import toeplitz
from scipy.special import fdtri, stdtr, stdtrit

from ces_data.arrays import F, I, Mask
from ces_identify.limits import ErrorLimits

BIN_S = 0.01  # [s] far below the correlation time of a damper's errors
COSINES, MIN_COSINES = 0.6, 4  # times the inverse share: cosines that are used, and at least
INSIGNIFICANT_IN_A_ROW = 5  # lags: K_N of Politis & White
FLAT = 0.5  # share of the flat-top window that is flat


def noise_rms(values: F) -> float:
    """Return the RMS of the white noise in samples (n,), by the median of their third differences; 0 of less than 8."""
    if len(values) < 8:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(values, 3))) / math.sqrt(20.0))


def find_runs(mask: Mask, segments: I) -> I:
    """Return the runs (r, 2) of the ticks where `mask` (m,) is true, as indices among these ticks."""
    starts = np.zeros(len(mask), bool)
    starts[segments[:, 0]] = True
    starts[1:] |= ~mask[:-1]
    begins = np.flatnonzero(starts[mask])
    return np.stack([begins, np.append(begins[1:], int(mask.sum()))], axis=1).astype(np.int64)


def covariance(x: F, y: F, runs: I, max_lag: int) -> tuple[F, F]:
    """Return the sum of x(k) y(k + lag) over the pairs inside runs, and the number of pairs.

    Both have shape (max_lag + 1,), for lags 0 to `max_lag`. The means must be subtracted before.
    """
    sums, pairs = np.zeros(max_lag + 1), np.zeros(max_lag + 1)
    for start, stop in runs:
        n = int(stop - start)
        size = 1 << (n + max_lag).bit_length()
        spectrum_x = np.fft.rfft(x[start:stop], size)
        spectrum = np.conj(spectrum_x) * (spectrum_x if y is x else np.fft.rfft(y[start:stop], size))
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


FINE = 1024  # steps for the variances of the slowest process


@dataclass(frozen=True)
class SumError:
    """Variance of a sum and its degrees of freedom; `fast` is the variance if nothing slow is possible."""

    variance: float
    freedom: float
    fast: float
    fast_freedom: float

    def half_width(self, level: float) -> float:
        """Return half the width of the interval around the sum that holds the true one by `level` (0 to 1)."""
        return float(np.sqrt(self.variance) * stdtrit(self.freedom, 0.5 + level / 2.0))

    def p_value(self, value: float) -> float:
        """Return the p-value of the sum `value` if the true one is zero."""
        return _p_value(value, self.variance, self.freedom)

    def fast_p_value(self, value: float) -> float:
        """Return the p-value if changes are fast: only a longer recording can show whether they are."""
        return _p_value(value, self.fast, self.fast_freedom)


def sum_bins(x: F, rate_Hz: float) -> F:
    """Return the sums of x (..., n) over bins of BIN_S; fewer than MIN_BINS are too few for an error."""
    starts = np.arange(0, x.shape[-1], max(1, round(BIN_S * rate_Hz)))
    return np.asarray(np.add.reduceat(x, starts, axis=-1))


def estimate_sum_error(x: F, seconds: float) -> SumError:
    """Return the error of the sum of x (n,), at least MIN_BINS values that last `seconds`."""
    share = max(ErrorLimits.SLOWEST_S / seconds, ErrorLimits.MIN_SHARE)
    count = max(MIN_COSINES, int(round(COSINES / share, 6)))
    squares = 0.5 * dct(x, type=2)[1 : count + 1] ** 2
    scaled = squares / relative_variances(share, count)
    variance, freedom = float(scaled.mean()), float(count)
    if _is_slower(scaled) and share < ErrorLimits.ALARM_SHARE:
        few = MIN_COSINES
        slower = float((squares[:few] / relative_variances(ErrorLimits.ALARM_SHARE, few)).mean())
        variance, freedom = max(variance, slower), float(few)
    return SumError(variance, freedom, float(squares.mean()), float(count))


def add_errors(errors: Sequence[SumError]) -> SumError:
    """Return the error of the total of independent sums; its degrees of freedom are Satterthwaite's."""
    variance, freedom = _add([(e.variance, e.freedom) for e in errors])
    return SumError(variance, freedom, *_add([(e.fast, e.fast_freedom) for e in errors]))


@lru_cache(maxsize=256)
def relative_variances(share: float, count: int) -> F:
    """Return the variances (count,) of the projections of a process on cosines, relative to that of its sum.

    The process is an Ornstein-Uhlenbeck process whose correlation time is `share` of its duration; the cosines are
    cos(pi j t / duration), j = 1 to `count`, scaled so that all variances are equal for white noise.
    """
    middle = (np.arange(FINE) + 0.5) / FINE
    cosines = np.sqrt(2.0) * np.cos(np.pi * np.outer(np.arange(count + 1), middle))
    cosines[0] = 1.0
    of_process = toeplitz(np.exp(-np.arange(FINE) / (FINE * share)))
    variances = np.einsum("ij,ij->i", cosines @ of_process, cosines)
    return np.asarray(variances[1:] / variances[0])


def _is_slower(scaled: F) -> bool:
    """Return whether the slowest projections are larger than the assumed bound makes plausible."""
    slow = int(np.clip(len(scaled) // 3, 2, 3))
    faster = float(scaled[slow:].mean())
    return float(scaled[:slow].mean()) > faster * float(fdtri(slow, len(scaled) - slow, ErrorLimits.ALARM))


def _add(parts: Sequence[tuple[float, float]]) -> tuple[float, float]:
    total = sum(variance for variance, _ in parts)
    if total <= 0.0:
        return 0.0, sum(freedom for _, freedom in parts)
    return total, total**2 / sum(variance**2 / freedom for variance, freedom in parts)


def _p_value(value: float, variance: float, freedom: float) -> float:
    if variance <= 0.0:
        return 1.0 if value == 0.0 else 0.0
    return float(2.0 * stdtr(freedom, -abs(value) / np.sqrt(variance)))


def adjusted_p_values(p_values: Sequence[float]) -> list[float]:
    """Return Holm's adjusted p-values, in the same order: a test is significant at a level if its value is below it."""
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[int(i)] = largest
    return adjusted


def step_levels(p_values: Sequence[float], alpha: float) -> list[float]:
    """Return for each test the significance level of Holm's step that decided it.

    An interval of 1 - that level excludes zero exactly if Holm's procedure at `alpha` calls the test significant: after
    the first test that is not, all further ones share its level.
    """
    levels, level, going = [alpha] * len(p_values), alpha, True
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        if going:
            level = alpha / (len(p_values) - rank)
            going = p_values[i] < level
        levels[int(i)] = level
    return levels
