"""What is wrong with a recording before any of it is used: findings in plain words, errors first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ces_identify.recordings.recording import Channel, Recording, Stamps
from ces_observer.errors import RecordingError

ERROR, WARNING = "error", "warning"
MAX_STROKE_M, MAX_CURRENT_A = 1.0, 100.0  # beyond these a unit is likelier to be wrong than the damper to be so large
BAD_SHARE = 0.01  # of samples that are NaN or infinite; preparation can leave out fewer
RATE_RATIO = 100.0
MISSING_SHARE = 0.01  # of the position's span that the current may be absent from
MISSING_S, EDGE_S, USUAL_INTERVALS = 0.5, 1.0, 20.0
SECOND = 1e9


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong; with severity "error" the recording cannot be used, with "warning" it can."""

    severity: str
    text: str


def findings(recording: Recording) -> tuple[Finding, ...]:
    """Return all that is wrong with a recording, errors first.

    Errors: position constant; a channel empty, or with more than 1 % NaN or infinite samples; time running backwards;
    two rates a factor of 100 apart; current absent for part of the time. Warnings: fewer NaN or infinite samples, a
    short absence of the current, a stroke or a current so large that its unit is in doubt.
    """
    start_ns = min((int(c.stamps_ns[0]) for c in recording.channels.values() if len(c)), default=0)
    found = [finding for channel in recording.channels.values() for finding in _in_channel(channel, start_ns)]
    found += [*_constant_position(recording), *_rates_apart(recording), *_current_missing(recording, start_ns)]
    found += _implausible(recording)
    return tuple(sorted(found, key=lambda finding: finding.severity != ERROR))


def require_usable(recording: Recording) -> tuple[Finding, ...]:
    """Return the warnings about a recording; raises RecordingError with the first error if there is one."""
    found = findings(recording)
    for finding in found:
        if finding.severity == ERROR:
            raise RecordingError(f"{recording.source or recording.name}: {finding.text}")
    return found


def mean_rate(channel: Channel) -> float:
    """Return the mean rate [Hz] of a channel over the whole of its span; 0 if it has none."""
    span = int(channel.stamps_ns.max() - channel.stamps_ns.min()) if len(channel) else 0
    return (len(channel) - 1) * SECOND / span if span else 0.0


def _in_channel(channel: Channel, start_ns: int) -> Iterator[Finding]:
    if not len(channel):
        yield Finding(ERROR, f"{channel.name}: the channel is empty; expected samples")
        return
    bad = ~np.isfinite(channel.values)
    if bad.any():
        first = (int(channel.stamps_ns[np.argmax(bad)]) - start_ns) / SECOND
        told = f"{int(bad.sum())} of {len(bad)} samples are NaN or infinite, the first at {first:.3f} s"
        if bad.mean() > BAD_SHARE:
            yield Finding(ERROR, f"{channel.name}: {told}; expected at most {BAD_SHARE:.0%}")
        else:
            yield Finding(WARNING, f"{channel.name}: {told}; they are left out")
    steps = np.diff(channel.stamps_ns)
    if (steps < 0).any():
        row = int(np.argmax(steps < 0))
        at = (int(channel.stamps_ns[row]) - start_ns) / SECOND
        told = (
            f"time runs backwards {int((steps < 0).sum())} times, first at {at:.3f} s by {-steps[row] / SECOND:.6f} s"
        )
        yield Finding(ERROR, f"{channel.name}: {told}; expected stamps in order (did a clock jump, or a bag loop?)")


def _constant_position(recording: Recording) -> Iterator[Finding]:
    values = recording.channels["position"].values if "position" in recording.channels else np.empty(0)
    values = values[np.isfinite(values)]
    if "position" in recording.constants:
        yield Finding(ERROR, "position: is a constant in the signals; expected a recorded stroke")
    elif len(values) and values.min() == values.max():
        yield Finding(ERROR, f"position: constant at {values[0]:g} m; expected a stroke (is it the right field?)")


def _rates_apart(recording: Recording) -> Iterator[Finding]:
    rates = {name: rate for name, channel in recording.channels.items() if (rate := mean_rate(channel)) > 0.0}
    for (slow, low), (fast, high) in combinations(sorted(rates.items(), key=lambda item: item[1]), 2):
        if high >= RATE_RATIO * low and "temperature" not in (slow, fast):
            yield Finding(
                ERROR,
                f"{slow} at {low:.4g} Hz and {fast} at {high:.4g} Hz: rates more than {RATE_RATIO:g} times apart",
            )


def _current_missing(recording: Recording, start_ns: int) -> Iterator[Finding]:
    """Name the longest stretch without current; an error if all of them together are more than a small share."""
    if not all(len(recording.channels.get(name, ())) for name in ("position", "current")):
        return
    position = recording.channel("position").stamps_ns
    stretches = missing_stretches(position, recording.channel("current").stamps_ns)
    if not stretches:
        return
    begin, end = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    share = sum(end - begin for begin, end in stretches) / int(np.ptp(position))
    told = f"from {(begin - start_ns) / SECOND:.3f} s to {(end - start_ns) / SECOND:.3f} s"
    if len(stretches) > 1:
        told += f" and {len(stretches) - 1} times more"
    severity = ERROR if share > MISSING_SHARE else WARNING
    yield Finding(severity, f"current: absent {told}, {share:.1%} of the time; expected it wherever there is position")


def _implausible(recording: Recording) -> Iterator[Finding]:
    """Doubt the unit of a position or current that hardly any damper has; robust, since wild samples are no unit."""
    for name, unit, other, most in (("position", "m", "mm", MAX_STROKE_M), ("current", "A", "mA", MAX_CURRENT_A)):
        values = recording.channels[name].values if name in recording.channels else np.empty(0)
        values = values[np.isfinite(values)]
        if not len(values):
            continue
        low, high = np.percentile(values, (1.0, 99.0))
        reach = high - low if name == "position" else max(abs(low), abs(high))
        if reach > most:
            yield Finding(
                WARNING,
                f"{name}: {'spans' if name == 'position' else 'reaches'} {reach:.4g} {unit}; if it is in {other}, give "
                f"it scale: 0.001 in the signals file",
            )


def missing_stretches(reference_ns: Stamps, stamps_ns: Stamps) -> list[tuple[int, int]]:
    """Return begin and end [ns] of the stretches inside the reference's span where stamps are missing.

    That is 0.5 s or 20 usual intervals, whichever is longer; at the edges, where topics come and go, at least 1 s.
    """
    first, last = int(reference_ns.min()), int(reference_ns.max())
    edges = np.concatenate([[first], np.sort(np.clip(stamps_ns, first, last)), [last]])
    lengths = np.diff(edges)
    usual = float(np.median(lengths[1:-1])) if len(lengths) > 2 else 0.0
    longest_allowed = np.full(len(lengths), max(MISSING_S * SECOND, USUAL_INTERVALS * usual))
    longest_allowed[[0, -1]] = np.maximum(longest_allowed[[0, -1]], EDGE_S * SECOND)
    return [(int(edges[i]), int(edges[i + 1])) for i in np.flatnonzero(lengths > longest_allowed)]
