"""Rare events, which an RMS hides: the largest local deviation of a force, against the rest of the recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, Mask
from ces_gap.grid import number_blocks
from ces_gap.limits import EvidenceLimits, RareLimits
from ces_gap.trace import Trace

QUARTILE, MEDIAN = (-math.log(-math.log(share)) for share in (0.25, 0.5))  # of a Gumbel distribution


@dataclass(frozen=True)
class RareDeviation:
    """A deviation of the measured force, `mean_N` [N] over a window, that is none of the noise's; where it lies.

    The mean over other windows of this length exceeds `limit_N` in `RareLimits.FALSE_ALARMS` of the diagnoses.
    """

    mean_N: float
    limit_N: float
    recording: str
    time_s: float  # of the middle of the window
    window_s: float
    stroke_m: float
    speed_m_s: float
    current_A: float


def find_rare_deviation(
    traces: Sequence[Trace], forces: Sequence[F], on_references: Sequence[F] = (), least_N: float = 0.0
) -> RareDeviation | None:
    """Return the largest local deviation of the measured force from `forces` [N] (n,); None if none stands out.

    Windows of 10 to 300 ms are compared. The largest of each block of 0.5 s follow a Gumbel distribution (Coles 2001),
    which their lower quartile and their median determine, so that neither events nor the colour of the noise count.
    What stands out exceeds its limit for this many blocks and windows, `least_N`, and the deviations `on_references`
    (n,).
    """
    errors = [np.where(t.usable, t.force - force, np.nan) for t, force in zip(traces, forces, strict=True)]
    deviations = [_test(traces, errors, on_references, window_s, least_N) for window_s in RareLimits.WINDOWS_S]
    return max(
        (deviation for deviation in deviations if deviation is not None),
        key=lambda deviation: abs(deviation.mean_N) / deviation.limit_N,
        default=None,
    )


def _test(
    traces: Sequence[Trace], errors: Sequence[F], on_references: Sequence[F], window_s: float, least_N: float
) -> RareDeviation | None:
    """Return the largest mean over windows of one length, None if it does not stand out."""
    lengths = [max(round(window_s * t.rate_Hz), 1) for t in traces]
    means = [_moving_mean(error, length) for error, length in zip(errors, lengths, strict=True)]
    blocks = number_blocks([t.time_s for t in traces], EvidenceLimits.BLOCK_S)
    largest = np.full(int(blocks[-1][-1]) + 1, -1.0)
    for mean, block in zip(means, blocks, strict=True):
        np.maximum.at(largest, block, np.nan_to_num(np.abs(mean), nan=-1.0))
    seen = largest[largest >= 0.0]
    if len(seen) < RareLimits.MIN_BLOCKS:
        return None
    low, middle = np.quantile(seen, (0.25, 0.5))
    scale = (middle - low) / (MEDIAN - QUARTILE)
    trials = len(seen) * len(RareLimits.WINDOWS_S)
    limit_N = float(middle + scale * (math.log(trials / RareLimits.FALSE_ALARMS) - MEDIAN))
    limit_N = max([limit_N, least_N, *(EvidenceLimits.UNSEEN * _largest(error, lengths[0]) for error in on_references)])
    number = int(np.argmax([np.nan_to_num(np.abs(mean)).max(initial=0.0) for mean in means]))
    trace, mean = traces[number], means[number]
    at = int(np.argmax(np.nan_to_num(np.abs(mean))))
    if not abs(mean[at]) > limit_N:
        return None
    inputs = trace.inputs
    place = (float(values[at]) for values in (inputs.position, inputs.speed, inputs.current))
    return RareDeviation(float(mean[at]), limit_N, trace.name, float(trace.time_s[at]), window_s, *place)


def _largest(error: F, length: int) -> float:
    return float(np.nan_to_num(np.abs(_moving_mean(error, length))).max(initial=0.0))


def _moving_mean(error: F, length: int) -> F:
    """Return the mean over `length` ticks about each tick (n,), less the median of the means; NaN where one is NaN."""
    out = np.full(len(error), np.nan)
    if len(error) < length:
        return out
    known: Mask = np.isfinite(error)
    totals = (np.concatenate([[0.0], np.cumsum(values)]) for values in (np.where(known, error, 0.0), known))
    total, count = (sums[length:] - sums[:-length] for sums in totals)
    means = np.where(count == length, total / length, np.nan)
    start = (length - 1) // 2
    out[start : start + len(means)] = means
    return out - np.nanmedian(out) if known.any() and np.isfinite(means).any() else out
