"""Sampling statistics of a channel as logged: count, rate, jitter, gaps and range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.recordings.checks import SECOND, mean_rate
from ces_identify.recordings.recording import Channel

GAP_INTERVALS = 5.0  # a longer interval, in median intervals, is a gap


@dataclass(frozen=True)
class ChannelStats:
    """Statistics of one channel; NaN where it has too few samples.

    `jitter_s` is the standard deviation of the intervals without gaps, `longest_s` the longest interval; `low` and
    `high` are the range of the finite values in the channel's unit.
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
    """Return the statistics of a channel, its stamps sorted first."""
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
