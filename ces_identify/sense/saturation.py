"""Detects a saturated force channel: flat tops at the limit of the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding
from ces_identify.recordings.recording import Recording

MIN_SAMPLES = 10  # at the limit
MIN_SHARE = 2e-4  # of all samples
MIN_PEAK_RATIO = 5.0  # samples at the limit over those at each neighbouring value
NEIGHBOURS = 5  # number of neighbouring values
SATURATES = "the channel saturates"
WRONG_SHARE = 0.02  # of the samples at a limit: a model would learn the sensor's limit


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


def saturation_findings(recording: Recording) -> Iterator[Finding]:
    """Yield a finding if the force saturates."""
    limits = find_saturations(recording) if "force" in recording.channels else ()
    if limits:
        share = sum(limit.share for limit in limits)
        yield Finding(
            WRONG_MODEL if share > WRONG_SHARE else WARNING,
            f"force: {SATURATES}: {describe_saturations(limits)}; record with a larger range",
        )


def describe_saturations(limits: tuple[Saturation, ...]) -> str:
    """Return the limits and their shares as text."""
    return " and ".join(f"{s.share:.1%} of the samples at {s.limit_N:.5g} N" for s in limits)
