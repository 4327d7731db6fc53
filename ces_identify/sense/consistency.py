"""Differences between recordings that are mistakes, not physics: mixed units or opposite signs.

Recordings go in; findings come out. The tests use robust spreads (1st to 99th percentile), the correlation of force
with speed, which is positive for every damper, and the forces at equal speeds and currents.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, finite_values, sort_findings
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.sense.force_ratio import ratio_findings
from ces_identify.sense.units import MAX_CURRENT_A, MAX_STROKE_M
from ces_observer.errors import RecordingError

UNIT_RATIO = 100.0  # ratio of spreads beyond that of any two experiments with one damper
MAX_SPEED_RATIO = 10.0  # largest ratio of speeds at which forces are compared
MIN_DAMPING_CORRELATION = 0.3  # smallest correlation of force with speed whose sign counts
BIN_S, MIN_BINS = 0.005, 50  # positions are averaged over bins to compute speeds; fewer bins give no correlation


@dataclass(frozen=True)
class Traits:
    """The compared quantities: spreads in SI units, and the correlation of force with speed (-1 to 1).

    `current_A` is the 99th percentile of the magnitude. NaN where the recording lacks the data.
    """

    name: str
    stroke_m: float
    speed_m_s: float
    current_A: float
    force_N: float
    damping: float


def traits(recording: Recording) -> Traits:
    """Return the traits of a recording."""
    speed, force = _speed_and_force(recording)
    current = np.abs(finite_values(recording, "current"))
    return Traits(
        name=recording.name,
        stroke_m=_robust_span(finite_values(recording, "position")),
        speed_m_s=_robust_span(speed),
        current_A=float(np.percentile(current, 99.0)) if len(current) else np.nan,
        force_N=_robust_span(finite_values(recording, "force")),
        damping=_correlation(speed, force),
    )


def differences(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the inconsistencies between recordings, each a "wrong model" that names them.

    They are strokes, currents or forces in different units, and opposite signs of the force.
    """
    all_ = [traits(recording) for recording in recordings]
    forces = list(_forces(all_)) or ratio_findings(recordings)
    return sort_findings(_strokes(all_), _currents(all_), forces, _signs(all_))


def require_consistent(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the warnings about recordings together; raises RecordingError if a model of them would be wrong."""
    results = differences(recordings)
    if results and results[0].severity != WARNING:
        raise RecordingError(results[0].text)
    return results


def _strokes(all_: Sequence[Traits]) -> Iterator[Finding]:
    low, high = _extremes(all_, "stroke_m")
    if high.stroke_m > MAX_STROKE_M and high.stroke_m > UNIT_RATIO * low.stroke_m:
        yield _unit_finding(
            "position", f"spans {high.stroke_m:.4g} m in {high.name}, {low.stroke_m:.4g} m in {low.name}", "mm"
        )


def _currents(all_: Sequence[Traits]) -> Iterator[Finding]:
    low, high = _extremes(all_, "current_A")
    if high.current_A > MAX_CURRENT_A and high.current_A > UNIT_RATIO * low.current_A:
        yield _unit_finding(
            "current", f"reaches {high.current_A:.4g} A in {high.name}, {low.current_A:.4g} A in {low.name}", "mA"
        )


def _forces(all_: Sequence[Traits]) -> Iterator[Finding]:
    low, high = _extremes(all_, "force_N")
    if high.force_N > UNIT_RATIO * low.force_N and high.speed_m_s < MAX_SPEED_RATIO * low.speed_m_s:
        spans = f"spans {high.force_N:.4g} N in {high.name}, {low.force_N:.4g} N in {low.name}, at speeds of "
        yield _unit_finding("force", f"{spans}{high.speed_m_s:.2g} and {low.speed_m_s:.2g} m/s", "kN")


def _unit_finding(signal: str, text: str, unit: str) -> Finding:
    return Finding(
        WRONG_MODEL,
        f"{signal}: {text}; expected one unit: is one of them in {unit}? convert it, or identify on them one by one",
        signal=signal,
    )


def _signs(all_: Sequence[Traits]) -> Iterator[Finding]:
    along = [t for t in all_ if t.damping >= MIN_DAMPING_CORRELATION]
    against = [t for t in all_ if t.damping <= -MIN_DAMPING_CORRELATION]
    if along and against:
        odd, rest = (against, along) if len(against) <= len(along) else (along, against)
        yield Finding(
            WRONG_MODEL,
            f"force {_sense(odd)} in {_names(odd)}, {_sense(rest)} in {_names(rest)}; expected one sign: "
            "position and force are positive in compression; set scale: -1 in the signals file of the wrong ones",
            signal="force",
        )


def _sense(some: Sequence[Traits]) -> str:
    return f"goes {'with' if some[0].damping > 0.0 else 'against'} speed (correlation {some[0].damping:.2f})"


def _names(some: Sequence[Traits]) -> str:
    shown = ", ".join(t.name for t in some[:3])
    return shown if len(some) <= 3 else f"{shown} and {len(some) - 3} more"


def _extremes(all_: Sequence[Traits], trait: str) -> tuple[Traits, Traits]:
    """Return the recordings with the smallest and the largest value, the same one twice if fewer than two have one."""
    known = [t for t in all_ if getattr(t, trait) > 0.0] or [all_[0]]
    ordered = sorted(known, key=lambda t: float(getattr(t, trait)))
    return ordered[0], ordered[-1]


def _robust_span(values: F) -> float:
    return float(np.ptp(np.percentile(values, (1.0, 99.0)))) if len(values) else np.nan


def _correlation(speed: F, force: F) -> float:
    if len(speed) < MIN_BINS or speed.std() == 0.0 or force.std() == 0.0:
        return np.nan
    return float(np.corrcoef(speed, force)[0, 1])


def _speed_and_force(recording: Recording) -> tuple[F, F]:
    """Return speed [m/s] and force [N] in the bins where both are known; without a force channel it is zero."""
    position = recording.channels.get("position")
    if position is None or len(position) < 3:
        return np.empty(0), np.empty(0)
    start = int(position.stamps_ns.min())
    width = max(BIN_S * 1e9, 2.0 * float(np.median(np.abs(np.diff(position.stamps_ns)))))
    bins, place = _average_bins(position, start, width)
    inner = bins[2:] - bins[:-2] == 2
    at, speed = bins[1:-1][inner], ((place[2:] - place[:-2]) / (2e-9 * width))[inner]
    if "force" not in recording.channels:
        return speed, np.zeros(len(speed))
    force_bins, force = _average_bins(recording.channels["force"], start, width)
    _, at_speed, at_force = np.intersect1d(at, force_bins, assume_unique=True, return_indices=True)
    return speed[at_speed], force[at_force]


def _average_bins(channel: Channel, start_ns: int, width_ns: float) -> tuple[I, F]:
    """Return the indices of the time bins with finite samples, and their means."""
    good = np.isfinite(channel.values)
    at = np.floor((channel.stamps_ns[good] - start_ns) / width_ns).astype(np.int64)
    bins, inverse, count = np.unique(at, return_inverse=True, return_counts=True)
    means: F = np.bincount(inverse, channel.values[good], minlength=len(bins)) / count
    return bins, means
