"""Clocks that drift apart: a delay between force and position that changes during a recording.

Two loggers with clocks of their own differ by 10 to 100 ppm, that is up to 60 ms after ten minutes. A constant delay
does not correct that. Begin and end of the recording are examined apart.
"""

from __future__ import annotations

from ces_identify.recordings.checks import WRONG_MODEL, Finding
from ces_identify.recordings.recording import Recording
from ces_identify.sense.delays import DelayEstimate, force_delay
from ces_identify.sense.motion import recorded_motion

THIRDS = ((0.0, 1.0 / 3.0), (1.0 / 3.0, 2.0 / 3.0), (2.0 / 3.0, 1.0))  # of the position's samples
MIN_CHANGE_S, CLEARLY = 0.01, 0.5  # between the first and the last third; in widths of the intervals
STEADY = 0.35  # of the change, by which the middle may miss the mean of both ends


def find_clock_drift(recording: Recording) -> Finding | None:
    """Return a finding if the force is late by another time at the end of the recording than at its begin.

    The middle must lie between: on a stroke that repeats, a delay is known but for a whole period.
    """
    first, middle, last = (_delay_within(recording, *third) for third in THIRDS)
    if first is None or middle is None or last is None or not _is_apart(first, last):
        return None
    if abs(middle.late_s - 0.5 * (first.late_s + last.late_s)) > STEADY * abs(last.late_s - first.late_s):
        return None
    return Finding(
        WRONG_MODEL,
        f"force: logged {_describe(first)} the position in the first third and {_describe(last)} it in the last: their "
        "clocks drift apart, which no constant delay corrects; log both with one clock, or rescale the stamps of one",
        signal="force",
    )


def _is_apart(a: DelayEstimate, b: DelayEstimate) -> bool:
    """Return whether two delays differ by more than what the damper's elasticity, which is in both, leaves open."""
    width = max(delay.high_s - delay.low_s for delay in (a, b))
    return not (a.beyond or b.beyond) and abs(a.late_s - b.late_s) > max(MIN_CHANGE_S, CLEARLY * width)


def _delay_within(recording: Recording, first: float, last: float) -> DelayEstimate | None:
    """Return the delay of the force in a part of the recording."""
    motion = recorded_motion(recording.part(first, last))
    return None if motion is None else force_delay(motion, far=False)


def _describe(delay: DelayEstimate) -> str:
    """Return about how much later than the position the force is."""
    return f"about {1e3 * abs(delay.late_s):.0f} ms {'after' if delay.late_s >= 0.0 else 'before'}"
