"""Block bootstrap of autocorrelated series, with intervals, p-values and false-discovery rates.

Recordings are concatenated and closed to a circle, so that every tick is drawn equally often (circular blocks: Politis
and Romano 1992). The few blocks that cross from one recording to the next do no harm.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.stats import false_discovery_control, norm
from scipy.stats import t as student

from ces_gap.trace import F
from ces_gap.where.axes import I

BLOCK_S = (0.25, 1.0)
BLOCK_LAGS = 6.0  # length of a block over that of the autocorrelation
QUIET_S = 0.05  # [s] for which the autocorrelation must stay insignificant
CHUNK = 2_000_000  # numbers drawn at once


def block_s(series: F, step_s: float) -> float:
    """Return the length of blocks [s]: several times the lag at which the autocorrelation becomes insignificant.

    It is insignificant if it stays below 2√(log₁₀ n / n) for a while (Politis and White 2004); the zero crossings of a
    periodic series do not count.
    """
    n, centred = len(series), series - series.mean()
    size = next_fast_len(2 * n)
    acf = np.abs(irfft(np.abs(rfft(centred, size)) ** 2, size)[: n // 2])
    quiet = acf < 2.0 * np.sqrt(np.log10(n) / n) * acf[0]
    run = max(1, round(QUIET_S / step_s))
    quiet_runs = np.flatnonzero(np.convolve(quiet, np.ones(run), mode="valid") > run - 0.5)
    lag = float(quiet_runs[0]) if len(quiet_runs) else float(n)
    return float(np.clip(BLOCK_LAGS * lag * step_s, *BLOCK_S))


def resampled_sums(series: F, length: int, resamples: int, rng: np.random.Generator) -> F:
    """Return the sums (resamples, m) of series (n, m) over n ticks drawn in blocks of `length` ticks."""
    n = len(series)
    length = min(length, n)
    starts = _starts(n, length, resamples, rng)
    running = np.concatenate([np.zeros((1, series.shape[1])), np.cumsum(np.r_[series, series[:length]], axis=0)])
    out = np.zeros((resamples, series.shape[1]))
    for start in starts.T:
        out += running[start + length] - running[start]
    out *= n / (starts.shape[1] * length)
    return out


def scattered_sums(series: F, members: F, length: int, resamples: int, rng: np.random.Generator) -> F:
    """Return sums over regions (resamples, m) of a series (n,) whose blocks are drawn at random.

    `members` (n, m) is the weight of each tick in each region and stays in place. This breaks any relation between the
    series and the regions, but keeps the autocorrelation within blocks.
    """
    n = len(series)
    length = min(length, n)
    starts = _starts(n, length, resamples, rng)
    doubled = np.r_[series, series[:length]]
    out = []
    for chunk in np.array_split(starts, max(1, resamples * n // CHUNK)):
        drawn = doubled[chunk[:, :, None] + np.arange(length)].reshape(len(chunk), -1)[:, :n]
        out.append(drawn @ members)
    return np.concatenate(out)


def t_interval(value: F, error: F, blocks: F) -> tuple[F, F]:
    """Return the 95 % intervals of means over so many `blocks` each, from their bootstrap standard errors.

    With k blocks the bootstrap error is too small by √((k−1)/k), and the tails of the normal distribution are too thin.
    """
    k = np.maximum(blocks, 2.0)
    half = student.ppf(0.975, k - 1.0) * error * np.sqrt(k / (k - 1.0))
    return np.asarray(value - half), np.asarray(value + half)


def effective_blocks(members: F, length: int) -> F:
    """Return the effective number of blocks of `length` ticks in each region (Kish), from the weights (n, m)."""
    starts = np.arange(0, len(members), length)
    weight = np.add.reduceat(members, starts, axis=0)
    return np.asarray(weight.sum(axis=0) ** 2 / np.maximum((weight**2).sum(axis=0), 1e-300))


def normal_scores(value: F, draws: F, min_spread: F | float, min_skew: F | float = 0.01) -> tuple[F, F]:
    """Return standard normal scores of values (m,) and of all draws (b, m) of their null distributions of mean 0.

    The null is a gamma distribution with the draws' spread and skewness, but at least `min_spread` and `min_skew`, as
    is usual for permutation tests (Mielke and Berry 2007). Wilson and Hilferty's cube root makes it normal, which
    resolves probabilities below 1/b.
    """
    spread = np.maximum(np.sqrt((draws**2).mean(axis=0)), np.maximum(min_spread, 1e-100))
    skew = np.clip(((draws / spread) ** 3).mean(axis=0), min_skew, 4.0)

    def score(x: F) -> F:
        root = np.cbrt(np.maximum(1.0 + 0.5 * skew * (x / spread), 0.0))
        return np.asarray(6.0 / skew * (root - 1.0) + skew / 6.0)

    return score(value), score(draws)


def p_value_of_largest(scores: F, draws: F) -> float:
    """Return the share of the draws (b, m) whose largest score reaches the largest of the scores (m,)."""
    count = int((draws.max(axis=1) >= scores.max()).sum())
    return (1.0 + count) / (1.0 + len(draws))


def q_values(scores: F) -> F:
    """Return the false-discovery rates (m,) of one-sided normal scores (Benjamini and Hochberg 1995)."""
    return np.asarray(false_discovery_control(norm.sf(scores)))


def _starts(n: int, length: int, resamples: int, rng: np.random.Generator) -> I:
    return rng.integers(0, n, (resamples, -(-n // length)))
