"""A recording in memory, of signals on one clock."""

from __future__ import annotations

import numpy as np

from ces_data.arrays import F
from ces_data.recording import Channel, Recording

UNITS = {"position": "m", "current": "A", "force": "N", "temperature": "degC"}


def recording_of(time_s: F, name: str = "made", start_ns: int = 0, **signals: F) -> Recording:
    """Return the recording of `signals` (n,) in SI units at the times (n,)."""
    stamps = start_ns + np.round(time_s * 1e9).astype(np.int64)
    return Recording(name, {n: Channel(n, UNITS[n], stamps, np.asarray(v)) for n, v in signals.items()})
