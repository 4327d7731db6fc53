"""Holes of a channel: where samples are missing between its neighbours, however short, so that nothing was measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.recording import Channel, Stamps

MAX_INTERVAL = 1.75  # of the usual one: a longer interval between two samples has lost one


def measured_at(channel: Channel, stamps_ns: Stamps) -> NDArray[np.bool_]:
    """Return where a channel was measured (n,): at its finite samples, and between two of them without a hole.

    A hole is an interval between finite samples that is longer than 1.75 usual ones (the 90th percentile), or that
    holds a sample that is not finite, unless most do, as in tables whose rows are denser than the measurement.
    """
    finite = np.flatnonzero(np.isfinite(channel.values))
    if len(finite) < 2:
        return np.zeros(len(stamps_ns), bool)
    logged = channel.stamps_ns[finite]
    interval, skips = np.diff(logged), np.diff(finite) > 1
    hole = interval > MAX_INTERVAL * np.percentile(interval, 90.0)
    if skips.mean() < 0.5:
        hole |= skips
    after = np.clip(np.searchsorted(logged, stamps_ns), 1, len(logged) - 1)
    inside = (stamps_ns >= logged[0]) & (stamps_ns <= logged[-1])
    return np.asarray(inside & (~hole[after - 1] | (stamps_ns == logged[after]) | (stamps_ns == logged[after - 1])))
