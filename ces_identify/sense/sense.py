"""The sense check that all programs share: `sense` for one recording, `sense_together` for those of one model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ces_identify.recordings.checks import WARNING, WRONG_MODEL, Finding, sort_findings
from ces_identify.recordings.recording import Recording
from ces_identify.sense.clock_drift import find_clock_drift
from ces_identify.sense.consistency import differences
from ces_identify.sense.delays import force_delay
from ces_identify.sense.exchange import find_exchange
from ces_identify.sense.force_map import is_constant
from ces_identify.sense.motion import Motion, join_motions, recorded_motion
from ces_identify.sense.rates import rate_findings
from ces_identify.sense.saturation import saturation_findings
from ces_identify.sense.sensors import sensor_findings
from ces_identify.sense.stuck_current import current_findings
from ces_identify.sense.timing import IS_DELAY, delay_findings, sign_findings, timing_findings
from ces_identify.sense.units import unit_findings
from ces_observer.errors import RecordingError

LONG_S = 60.0  # clocks that differ by 100 ppm drift by 6 ms in it


def sense(recording: Recording) -> tuple[Finding, ...]:
    """Return what is wrong with a recording that can be read, the worst first, each with its remedy.

    "wrong model": a model of it would be wrong. A check that cannot know says nothing.
    """
    motion = recorded_motion(recording)
    if exchange := find_exchange(recording, motion):
        return (exchange,)
    sensors = [*saturation_findings(recording), *sensor_findings(recording)]
    intact = None if any(f.severity == WRONG_MODEL for f in sensors) else motion  # else follow-up findings mislead
    return sort_findings(
        unit_findings(recording, motion),
        () if motion is None else sign_findings(motion) if sensors else _timing(recording, motion),
        rate_findings(recording),
        sensors,
        current_findings(recording, intact),
    )


def _timing(recording: Recording, motion: Motion) -> Sequence[Finding]:
    """Return the findings on delays and signs of sensors without a fault; clocks that drift replace a delay."""
    found = list(timing_findings(motion))
    late = any(IS_DELAY in f.text and f.signal != "current" for f in found)
    drift = (
        find_clock_drift(recording)
        if late or np.ptp(recording.channels["position"].stamps_ns) >= 1e9 * LONG_S
        else None
    )
    return found if drift is None else [drift]


def sense_each(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the findings on each recording, with its name, and on what they show together, the worst first."""
    single = sort_findings(
        replace(f, text=f"{r.name}: {f.text}", recording=r.name) for r in recordings for f in sense(r)
    )
    if len(recordings) < 2:
        return single
    known = {f.signal for f in single if f.severity == WRONG_MODEL}
    between = [f for f in differences(recordings) if f.signal not in known]
    faulty = {f.recording for f in single if f.signal in ("position", "force")}
    known_bad = between or any(f.severity == WRONG_MODEL or IS_DELAY in f.text for f in single)
    sound = [r for r in recordings if r.name not in faulty]
    return sort_findings(between, single, () if known_bad else _joint_delay(sound))


def _joint_delay(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield the delay that recordings show together where none shows it alone, as sines of several frequencies do."""
    motions = [motion for recording in recordings if (motion := recorded_motion(recording)) is not None]
    if len(motions) > 1:
        motion = join_motions(motions)
        found = delay_findings(motion, force_delay(motion))
        yield from (replace(f, text=f"{len(motions)} recordings together: {f.text}") for f in found)


def sense_together(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Return the findings on recordings for one model, and a current that is the same in all; the worst first."""
    return sort_findings(sense_each(recordings), _one_current(recordings))


def require_sensible(findings: Sequence[Finding], go_on: bool = False) -> tuple[str, ...]:
    """Return the texts of the findings that a model is identified in spite of: none, unless `go_on`.

    Raises RecordingError with the first finding because of which a model would be wrong, if not `go_on`.
    """
    wrong = tuple(f.text for f in findings if f.severity == WRONG_MODEL)
    if wrong and not go_on:
        more = f" (and {len(wrong) - 1} more findings like this)" if len(wrong) > 1 else ""
        raise RecordingError(f"{wrong[0]}{more}; a model would be wrong: --force identifies all the same")
    return wrong


def _one_current(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield a finding if the recorded current stays at one value, other than zero, in all recordings."""
    currents = [r.channels["current"].values for r in recordings if "current" in r.channels]
    if len(currents) < len(recordings) or not currents:
        return
    values = np.concatenate([current[np.isfinite(current)] for current in currents])
    if len(values) and is_constant(values) and abs(values.mean()) > 1e-3:
        yield Finding(
            WARNING,
            f"current: {values.mean():.3g} A in all recordings; a model knows no other current: record others, too, or "
            "check its topic",
            signal="current",
        )
