"""A force channel that saturates: flat tops, where the sensor tells its own limit and not the damper's force."""

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
MIN_PEAK_RATIO = 5.0  # times as many as at any of the next values inside
NEIGHBOURS = 5  # values inside that are looked at
MAX_SATURATED_SHARE = 0.25  # of samples at a limit with which nothing can be diagnosed
AROUND_S = 0.01  # [s] on either side of a saturated sample that filters mix it into


@dataclass(frozen=True)
class Saturation:
    """The value [N] at which a force channel saturates, and the share of its samples that stand there."""

    limit_N: float
    share: float


def find_saturations(recording: Recording) -> tuple[Saturation, ...]:
    """Return the limits at which the force saturates, lowest first; none if it does not.

    A limit is an end of the range where samples heap up: a force that only turns round there leaves about as many
    samples on the values just inside, however coarse the converter.
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
    """Yield what is to be said of a force that saturates; raises GapError if it does so most of the time."""
    found = find_saturations(recording)
    if not found:
        return
    told = " and ".join(f"{s.share:.1%} of the samples at {s.limit_N:.5g} N" for s in found)
    if sum(s.share for s in found) > MAX_SATURATED_SHARE:
        raise GapError(
            f"{recording.name}: the force channel saturates: {told}; expected at most {MAX_SATURATED_SHARE:.0%}: "
            "record again with a larger range"
        )
    yield f"{recording.name}: the force channel saturates: {told}; these are left out, record with a larger range"


def exclude_saturated_ticks(trace: Trace) -> Trace:
    """Return the trace with the ticks near saturated samples not usable."""
    found = find_saturations(trace.recording) if "force" in trace.recording.channels else ()
    if not found:
        return trace
    force = trace.recording.channel("force")
    flat = np.isin(force.values, [s.limit_N for s in found])
    start = int(trace.recording.channel("position").stamps_ns[0])
    seconds = np.sort((force.stamps_ns[flat] - start) * 1e-9)
    return replace(trace, usable=trace.usable & ~_is_near(trace.time_s, seconds))


def _is_near(times: NDArray[np.float64], seconds: NDArray[np.float64]) -> B:
    """Return which times (n,) lie within AROUND_S of one of the seconds (m,), which are in order."""
    first = np.searchsorted(seconds, times - AROUND_S)
    return np.asarray(first < np.searchsorted(seconds, times + AROUND_S, side="right"))
