"""The check that all programs share: `check_recording` for one recording, `check_together` for those of one model.

Recordings in; findings with a remedy out. Differences between recordings that are mistakes, mixed units or opposite
signs, show in robust spreads (1st to 99th percentile), in the correlation of force with speed, which is positive for
every damper, and in the forces at equal speeds and currents.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from ces_data.arrays import F, I
from ces_data.checks.delays import delay_findings, force_delay, sign_findings
from ces_data.checks.derivatives import derivative_findings
from ces_data.checks.jumps import find_clock_drift, find_drift_within, split_spikes
from ces_data.checks.motion import is_constant, join_motions, recorded_motion
from ces_data.checks.sensors import current_findings, rate_findings, saturation_findings, sensor_findings
from ces_data.checks.units import find_exchange, half_span, ratio_findings, unit_findings
from ces_data.findings import ERROR, WARNING, WRONG_MODEL, DelayFinding, Finding, findings, finite_values, sort_findings
from ces_data.limits import DamperLimits, DriftLimits, RatioLimits, StatisticLimits
from ces_data.recording import Channel, Recording
from ces_observer.errors import OptionName, RecordingError
from ces_observer.signals import UNITS

COMPARED = (  # signal, trait, the limit of any damper, verb, and the units that it may be in instead
    ("position", "stroke_m", DamperLimits.MAX_STROKE_M, "spans", "mm, cm or inches"),
    ("current", "current_A", DamperLimits.MAX_CURRENT_A, "reaches", "mA"),
    ("force", "force_N", 0.0, "spans", "kN or kip"),
)
BIN_S = 0.005  # positions are averaged over bins to compute speeds


def check_recording(recording: Recording) -> tuple[Finding, ...]:
    """Return what is wrong with a recording that can be read, the worst first, each with its remedy.

    "wrong model": a model of it would be wrong. A check that cannot know says nothing.
    """
    recording, spikes = split_spikes(recording)
    if any(f.severity == WRONG_MODEL for f in spikes):
        return sort_findings(spikes)  # follow-up findings would mislead
    motion = recorded_motion(recording)
    if exchange := find_exchange(recording, motion):
        return (exchange,)
    sensors = [*saturation_findings(recording), *sensor_findings(recording)]
    timing: list[Finding] = []
    if motion is not None and sensors:
        timing = list(sign_findings(motion))
    elif motion is not None:
        delay = force_delay(motion)
        signs = list(sign_findings(motion, delay))
        timing = signs or list(delay_findings(motion, delay))  # of a right sign
        long = np.ptp(recording.channels["position"].stamps_ns) >= 1e9 * DriftLimits.LONG_S
        drift = find_drift_within(motion, delay) or (find_clock_drift(recording) if long else None)
        timing = [*signs, drift] if drift else timing  # clocks that drift replace a delay
    intact = None if any(f.severity == WRONG_MODEL for f in sensors) else motion  # else follow-up findings mislead
    others = spikes, rate_findings(recording), sensors, current_findings(recording, intact)
    return sort_findings(unit_findings(recording, motion), timing, derivative_findings(recording), *others)


def find_all_faults(recording: Recording) -> tuple[Finding, ...]:
    """Return the faults of a recording and, if it can be used, what the checks find, the worst first."""
    faults = findings(recording)
    return faults if any(f.severity == ERROR for f in faults) else sort_findings(faults, check_recording(recording))


def check_each(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the findings on each recording, with its name, and on what they show together, the worst first."""
    single = sort_findings(
        replace(f, text=f"{r.name}: {f.text}", recording=r.name) for r in recordings for f in check_recording(r)
    )
    if len(recordings) < 2:
        return single
    wrong = {f.signal for f in single if f.severity == WRONG_MODEL}
    between = [f for f in find_differences(recordings) if f.signal not in wrong]
    if between or any(f.severity == WRONG_MODEL or isinstance(f, DelayFinding) for f in single):
        return sort_findings(between, single)
    faulty = {f.recording for f in single if f.signal in ("position", "force")}
    motions = [m for r in recordings if r.name not in faulty and (m := recorded_motion(r)) is not None]
    if len(motions) < 2:
        return single
    motion = join_motions(motions)  # a delay that none shows alone, as of sines of several frequencies
    joint = delay_findings(motion, force_delay(motion))
    return sort_findings(single, (replace(f, text=f"{len(motions)} recordings together: {f.text}") for f in joint))


def check_together(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the findings on recordings for one model, and a current that is the same in all; the worst first."""
    faults = check_each(recordings)
    currents = [finite_values(r, "current") for r in recordings if "current" in r.channels]
    values = np.concatenate(currents) if currents and len(currents) == len(recordings) else np.empty(0)
    if not len(values) or not is_constant(values) or abs(values.mean()) <= 1e-3:
        return faults
    text = "in all recordings; a model knows no other current: record others, too, or check its topic"
    return sort_findings(faults, [Finding(WARNING, f"current: {values.mean():.3g} A {text}", "current")])


def require_sound(findings: Sequence[Finding], ignore_findings: bool = False) -> tuple[str, ...]:
    """Return the texts of "wrong model" findings if `ignore_findings`, else raise RecordingError with the first."""
    wrong = tuple(f.text for f in findings if f.severity == WRONG_MODEL)
    if wrong and not ignore_findings:
        more = f" (and {len(wrong) - 1} more findings like this)" if len(wrong) > 1 else ""
        ignore = OptionName("ignore_findings", True)
        raise RecordingError(f"{wrong[0]}{more}; a model would be wrong: ", ignore, " identifies all the same")
    return wrong


@dataclass(frozen=True)
class Traits:
    """Spreads in SI units (`current_A`: 99th percentile), correlation of force with speed (-1 to 1); NaN if unknown."""

    name: str
    stroke_m: float
    speed_m_s: float
    current_A: float
    force_N: float
    damping: float


def find_traits(recording: Recording) -> Traits:
    """Return the traits of a recording."""
    speed, force = _speed_and_force(recording)
    current = np.abs(finite_values(recording, "current"))
    is_known = len(speed) >= StatisticLimits.ENOUGH and speed.std() != 0.0 and force.std() != 0.0
    return Traits(
        name=recording.name,
        stroke_m=2.0 * half_span(finite_values(recording, "position"), np.nan),
        speed_m_s=2.0 * half_span(speed, np.nan),
        current_A=float(np.percentile(current, 99.0)) if len(current) else np.nan,
        force_N=2.0 * half_span(finite_values(recording, "force"), np.nan),
        damping=float(np.corrcoef(speed, force)[0, 1]) if is_known else np.nan,
    )


def find_differences(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return "wrong model" findings between recordings: different units of a signal, opposite signs of the force."""
    traits = [find_traits(recording) for recording in recordings]
    units = list(_compare_units(traits))
    ratios = () if any(f.signal == "force" for f in units) else ratio_findings(recordings)
    return sort_findings(units, ratios, _compare_signs(traits))


def require_consistent(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the warnings about recordings together; raises RecordingError if a model of them would be wrong."""
    results = find_differences(recordings)
    if results and results[0].severity != WARNING:
        raise RecordingError(results[0].text)
    return results


def _compare_units(traits: Sequence[Traits]) -> Iterator[Finding]:
    """Yield a finding per trait beyond any damper's limit and far smaller elsewhere; forces at like speeds only."""
    for signal, trait, limit, verb, unit in COMPARED:
        ordered = sorted((t for t in traits if getattr(t, trait) > 0.0), key=attrgetter(trait)) or [traits[0]]
        low, high = ordered[0], ordered[-1]
        smallest, largest = getattr(low, trait), getattr(high, trait)
        alike = signal != "force" or high.speed_m_s < RatioLimits.MAX_SPEED_RATIO * low.speed_m_s
        if not alike or not largest > limit or not largest > RatioLimits.SPREAD * smallest:
            continue
        si = UNITS[signal]
        text = f"{signal}: {verb} {largest:.4g} {si} in {high.name}, {smallest:.4g} {si} in {low.name}"
        text += f", at speeds of {high.speed_m_s:.2g} and {low.speed_m_s:.2g} m/s" if signal == "force" else ""
        remedy = f"expected one unit: is one of them in {unit}? convert it, or identify on them one by one"
        yield Finding(WRONG_MODEL, f"{text}; {remedy}", signal)


def _compare_signs(traits: Sequence[Traits]) -> Iterator[Finding]:
    along = [t for t in traits if t.damping >= StatisticLimits.DAMPING]
    against = [t for t in traits if t.damping <= -StatisticLimits.DAMPING]
    if not along or not against:
        return

    def describe(some: Sequence[Traits]) -> str:
        names = ", ".join(t.name for t in some[:3]) + (f" and {len(some) - 3} more" if len(some) > 3 else "")
        direction = "with" if some[0].damping > 0.0 else "against"
        return f"goes {direction} speed (correlation {some[0].damping:.2f}) in {names}"

    odd, others = (against, along) if len(against) <= len(along) else (along, against)
    remedy = "position and force are positive in compression; set scale: -1 in the signals file of the wrong ones"
    yield Finding(WRONG_MODEL, f"force {describe(odd)}, {describe(others)}; expected one sign: {remedy}", "force")


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
