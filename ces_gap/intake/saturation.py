"""Detects a saturated force channel: flat tops at the limit of the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.errors import GapError
from ces_gap.trace import Trace
from ces_identify.recordings.recording import Recording

B = NDArray[np.bool_]

MIN_SAMPLES = 10  # at the limit
MIN_SHARE = 2e-4  # of all samples
MIN_PEAK_RATIO = 5.0  # samples at the limit over those at each neighbouring value
NEIGHBOURS = 5  # number of neighbouring values
MAX_SATURATED_SHARE = 0.25  # of samples at a limit; a diagnosis needs fewer
AROUND_S = 0.01  # [s] on both sides of a saturated sample that filters spread it over


@dataclass(frozen=True)
class Saturation:
    """The value [N] at which a force channel saturates, and the share of its samples at this limit."""

    limit_N: float
    share: float


def find_saturations(recording: Recording) -> tuple[Saturation, ...]:
    """Return the limits at which the force saturates, lowest first; empty if it does not.

    Samples accumulate at a limit. A force that only reverses there leaves about as many samples on the neighbouring
    values, even with a coarse converter.
    """
    force = recording.channel("force").values
    values, counts = np.unique(force[np.isfinite(force)], return_counts=True)
    if len(values) < 2 * NEIGHBOURS:
        return ()
    total = int(counts.sum())
    ends = ((values, counts), (values[::-1], counts[::-1]))
    return tuple(
        Saturation(float(v[0]), float(c[0]) / total)
        for v, c in ends
        if c[0] >= max(MIN_SAMPLES, MIN_SHARE * total) and c[0] >= MIN_PEAK_RATIO * c[1 : NEIGHBOURS + 1].max()
    )


def saturation_notes(recording: Recording) -> Iterator[str]:
    """Yield a note if the force saturates; raises GapError if the share exceeds `MAX_SATURATED_SHARE`."""
    limits = find_saturations(recording)
    if not limits:
        return
    text = " and ".join(f"{s.share:.1%} of the samples at {s.limit_N:.5g} N" for s in limits)
    if sum(s.share for s in limits) > MAX_SATURATED_SHARE:
        raise GapError(
            f"{recording.name}: the force channel saturates: {text}; expected at most {MAX_SATURATED_SHARE:.0%}: "
            "record again with a larger range"
        )
    yield f"{recording.name}: the force channel saturates: {text}; they are not used; record with a larger range"


def exclude_saturated_ticks(trace: Trace) -> Trace:
    """Return the trace with the ticks near saturated samples marked unusable."""
    limits = find_saturations(trace.recording) if "force" in trace.recording.channels else ()
    if not limits:
        return trace
    force = trace.recording.channel("force")
    flat = np.isin(force.values, [s.limit_N for s in limits])
    start = int(trace.recording.channel("position").stamps_ns[0])
    seconds = np.sort((force.stamps_ns[flat] - start) * 1e-9)
    return replace(trace, usable=trace.usable & ~_is_near(trace.time_s, seconds))


def _is_near(times: NDArray[np.float64], seconds: NDArray[np.float64]) -> B:
    """Return the mask of the times (n,) within `AROUND_S` of one of the sorted `seconds` (m,)."""
    first = np.searchsorted(seconds, times - AROUND_S)
    return np.asarray(first < np.searchsorted(seconds, times + AROUND_S, side="right"))
