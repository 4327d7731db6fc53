"""Detects a saturated force or position: flat tops at the limit of the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, mean_rate
from ces_identify.recordings.recording import Channel, Recording

MIN_SAMPLES = 10  # at the limit
MIN_SHARE = 2e-4  # of all samples
MIN_PEAK_RATIO = 5.0  # samples at the limit over those at each neighbouring value
NEIGHBOURS = 5  # number of neighbouring values
SATURATES = "the channel saturates"
REMEDIES = {"force": "record with a larger range", "position": "move the sensor's range to that of the stroke"}
ARRIVAL_S, ARRIVAL_SPEED = 0.01, 0.2  # before a limit of the position: its speed, of its RMS; a stop by nature brakes
MIN_STAY = 3  # samples at a limit of the position, on average
WRONG_SHARE = 0.02  # of the samples at a limit: a model would learn the sensor's limit


@dataclass(frozen=True)
class Saturation:
    """The value [N or m] at which a channel saturates, and the share of its samples at this limit."""

    limit: float
    share: float


def find_saturations(recording: Recording, signal: str = "force") -> tuple[Saturation, ...]:
    """Return the limits at which the force, or the position, saturates, lowest first; empty if it does not.

    Samples accumulate at a limit. A force that only reverses there leaves about as many samples on the neighbouring
    values, even with a coarse converter.
    """
    channel = recording.channel(signal)
    values, counts = np.unique(channel.values[np.isfinite(channel.values)], return_counts=True)
    if len(values) < 2 * NEIGHBOURS:
        return ()
    total = int(counts.sum())
    ends = ((values, counts), (values[::-1], counts[::-1]))
    return tuple(
        Saturation(float(v[0]), float(c[0]) / total)
        for v, c in ends
        if c[0] >= max(MIN_SAMPLES, MIN_SHARE * total)
        and c[0] >= MIN_PEAK_RATIO * c[1 : NEIGHBOURS + 1].max()
        and (signal == "force" or _arrives_fast(channel, float(v[0])))
    )


def _arrives_fast(channel: Channel, limit: float) -> bool:
    """Return whether the position runs into a limit instead of coming to rest there, as a piston does."""
    values = channel.values
    back = max(1, round(ARRIVAL_S * mean_rate(channel)))
    steps = np.abs(values[back:] - values[:-back])
    arrivals = np.flatnonzero((values[1:] == limit) & (values[:-1] != limit)) - back
    if (values == limit).sum() < MIN_STAY * len(arrivals):  # a noise-free sine touches its largest value only
        return False
    arrivals = arrivals[arrivals >= 0]
    usual = float(np.sqrt(np.nanmean(steps**2)))
    return bool(len(arrivals)) and float(np.nanmedian(steps[arrivals])) > ARRIVAL_SPEED * usual


def saturation_findings(recording: Recording) -> Iterator[Finding]:
    """Yield a finding for the force and for the position if it saturates."""
    for signal, remedy in REMEDIES.items():
        limits = find_saturations(recording, signal) if signal in recording.channels else ()
        if limits:
            share = sum(limit.share for limit in limits)
            yield Finding(
                WRONG_MODEL if share > WRONG_SHARE else WARNING,
                f"{signal}: {SATURATES}: {describe_saturations(limits, recording.channel(signal).unit)}; {remedy}",
                signal=signal,
            )


def describe_saturations(limits: tuple[Saturation, ...], unit: str = "N") -> str:
    """Return the limits and their shares as text."""
    return " and ".join(f"{s.share:.1%} of the samples at {s.limit:.5g} {unit}" for s in limits)
