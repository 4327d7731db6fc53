"""How a channel was sampled: counts, rate, jitter, gaps and range, as they stand in the log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.recordings.checks import SECOND, mean_rate
from ces_identify.recordings.recording import Channel

GAP_INTERVALS = 5.0  # a gap is an interval longer than so many median intervals


@dataclass(frozen=True)
class ChannelStats:
    """Figures of one channel; those that its samples cannot give are NaN.

    `jitter_s` is the standard deviation of the intervals that are no gaps, `longest_s` the longest interval; `low` and
    `high` are the range of the finite values, in the channel's unit.
    """

    count: int
    duration_s: float
    rate_Hz: float
    jitter_s: float
    longest_s: float
    gaps: int
    low: float
    high: float


def channel_stats(channel: Channel) -> ChannelStats:
    """Look at a channel; intervals are taken between stamps in the order of time."""
    intervals_ns = np.diff(np.sort(channel.stamps_ns))
    usual_ns = float(np.median(intervals_ns)) if len(intervals_ns) else 0.0
    gaps = intervals_ns.astype(np.float64) > GAP_INTERVALS * usual_ns
    values = channel.values[np.isfinite(channel.values)]
    return ChannelStats(
        count=len(channel),
        duration_s=float(intervals_ns.sum() / SECOND),
        rate_Hz=mean_rate(channel),
        jitter_s=float(intervals_ns[~gaps].std() / SECOND) if len(intervals_ns) else np.nan,
        longest_s=float(intervals_ns.max() / SECOND) if len(intervals_ns) else np.nan,
        gaps=int(gaps.sum()),
        low=float(values.min()) if len(values) else np.nan,
        high=float(values.max()) if len(values) else np.nan,
    )
