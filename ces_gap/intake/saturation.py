"""A saturated force channel: its ticks are not used, and too many of them are refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.errors import GapError
from ces_gap.trace import Trace
from ces_identify.recordings.recording import Recording
from ces_identify.sense.saturation import SATURATES, describe_saturations, find_saturations

B = NDArray[np.bool_]

MAX_SATURATED_SHARE = 0.25  # of samples at a limit; a diagnosis needs fewer
AROUND_S = 0.01  # [s] on both sides of a saturated sample that filters spread it over


def saturation_notes(recording: Recording) -> Iterator[str]:
    """Yield a note if the force saturates; raises GapError if the share exceeds `MAX_SATURATED_SHARE`."""
    limits = find_saturations(recording)
    if not limits:
        return
    text = describe_saturations(limits)
    if sum(s.share for s in limits) > MAX_SATURATED_SHARE:
        raise GapError(
            f"{recording.name}: force: {SATURATES}: {text}; expected at most {MAX_SATURATED_SHARE:.0%}: "
            "record again with a larger range"
        )
    yield f"{recording.name}: force: {SATURATES}: {text}; they are not used; record with a larger range"


def exclude_saturated_ticks(trace: Trace) -> Trace:
    """Return the trace with the ticks near saturated samples marked unusable."""
    limits = find_saturations(trace.recording) if "force" in trace.recording.channels else ()
    if not limits:
        return trace
    force = trace.recording.channel("force")
    flat = np.isin(force.values, [s.limit for s in limits])
    start = int(trace.recording.channel("position").stamps_ns[0])
    seconds = np.sort((force.stamps_ns[flat] - start) * 1e-9)
    return replace(trace, usable=trace.usable & ~_is_near(trace.time_s, seconds))


def _is_near(times: NDArray[np.float64], seconds: NDArray[np.float64]) -> B:
    """Return the mask of the times (n,) within `AROUND_S` of one of the sorted `seconds` (m,)."""
    first = np.searchsorted(seconds, times - AROUND_S)
    return np.asarray(first < np.searchsorted(seconds, times + AROUND_S, side="right"))
