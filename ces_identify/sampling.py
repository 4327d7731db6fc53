"""The choice of rate, differentiator bandwidth and outlier threshold from the position samples alone.

The differentiator is a steady-state Kalman filter with one free number, so it is chosen by maximum likelihood: the
bandwidth whose one-step position predictions have the least variance (prediction-error method; Ljung, System
Identification, 2nd ed., sec. 7.2). No force is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_identify import kernels
from ces_identify.recording import Recording
from ces_identify.series import usable_samples
from ces_observer.errors import RecordingError
from ces_observer.model import Sampling

HIGHEST_RATE = 1000.0  # [Hz] damping forces have no content that calls for more
OUTLIER_FACTOR = 25.0  # times the robust standard deviation of the innovations


def choose_sampling(
    recordings: Sequence[Recording],
    rate_Hz: float | None = None,
    bandwidth_Hz: float | None = None,
    max_gap_s: float | None = None,
    warm_up_s: float = 0.5,
) -> Sampling:
    """Return the sampling rules for models of these recordings; numbers given are kept.

    The rate is the lowest position rate among the recordings, at most 1000 Hz; a gap is more than 50 ms or ten
    sampling intervals.
    """
    rates = [sample_rate(recording) for recording in recordings]
    gap = max(0.05, 10.0 / min(rates)) if max_gap_s is None else max_gap_s
    rate = min([HIGHEST_RATE, *(float(f"{r:.4g}") for r in rates)]) if rate_Hz is None else rate_Hz
    bandwidth = likeliest_bandwidth(recordings, gap) if bandwidth_Hz is None else bandwidth_Hz
    outlier = OUTLIER_FACTOR * max(_innovation_rms(r, bandwidth, gap) for r in recordings)
    return Sampling(rate, round(bandwidth, 2), float(f"{outlier:.3g}"), gap, warm_up_s=warm_up_s)


def sample_rate(recording: Recording) -> float:
    """Return the median rate of the position samples [Hz]."""
    stamps = recording.channel("position").stamps_ns
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    if len(steps) < 10:
        raise RecordingError(f"{recording.name}: {len(stamps)} position samples; expected at least ten in time order")
    return float(1e9 / np.median(steps))


def likeliest_bandwidth(recordings: Sequence[Recording], max_gap_s: float) -> float:
    """Return the bandwidth [Hz] of greatest likelihood over all recordings, on a log grid refined once."""
    rate = min(sample_rate(r) for r in recordings)
    grid = np.geomspace(rate / 300.0, rate / 5.0, 25)
    for _ in range(2):
        costs = [sum(np.log(_innovation_rms(r, b, max_gap_s)) for r in recordings) for b in grid]
        best = int(np.argmin(costs))
        grid = np.geomspace(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)], 9)
    return float(grid[4])


def _innovation_rms(recording: Recording, bandwidth: float, max_gap_s: float) -> float:
    samples = usable_samples(recording, 1e6)
    low, high = np.percentile(samples.position, (0.1, 99.9))
    gross = max(0.2 * (high - low), 1e-9)  # so that wild samples do not decide what an outlier is
    *_, squares = kernels.track(samples.stamps_ns, samples.position, 100.0, bandwidth, round(max_gap_s * 1e9), gross)
    return float(np.sqrt(squares / len(samples.position))) + 1e-12
