"""A speed in a log: where it is written, and the stroke that is its integral where there is no position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import butter, detrend, sosfiltfilt

from ces_data.recording import Channel, Recording
from ces_observer.errors import RecordingError
from ces_observer.signals import Constant, FieldPath, Signal

CORNER_HZ = 0.1  # of the high-pass; Keio's last 2.5 s alone: RMS 0.2 mm from their stroke within 10 s, of 22 mm
MIN_SAMPLES = 20
INTEGRATED = (
    f"position: none was measured; it is the integral of the speed, without a straight line and below {CORNER_HZ:g} Hz"
)


def with_stroke(recording: Recording) -> Recording:
    """Return the recording with a position: the integral [m] of its speed [m/s] without a straight line and what
    is below the corner, without phase shift.

    Raises RecordingError if it has too few samples, or if its times do not go forward.
    """
    speed = recording.channel("speed").finite()
    steps_s = np.diff(speed.stamps_ns) * 1e-9
    if len(speed) < MIN_SAMPLES or steps_s.min() < 0.0:
        expected = f"expected {MIN_SAMPLES} or more in the order of time, to integrate the speed"
        raise RecordingError(f"{recording.source or recording.name}: {len(speed)} samples of the speed; {expected}")
    means = 0.5 * (speed.values[1:] + speed.values[:-1])
    stroke = np.concatenate([[0.0], np.cumsum(means * steps_s)])
    rate = 1.0 / steps_s.mean()  # rows of a log are nearly even
    high_pass = butter(2, CORNER_HZ, "high", fs=rate, output="sos")
    beyond = min(len(stroke) - 1, round(rate / CORNER_HZ))  # the ends are mirrored, so that they make no step
    values = sosfiltfilt(high_pass, detrend(stroke), padtype="even", padlen=beyond)
    position = Channel("position", "m", speed.stamps_ns, values)
    channels = {"position": position, **recording.channels, "speed": speed}
    return replace(recording, channels=channels, optional=frozenset())


def velocity_beside(position: Signal | Constant) -> Signal | None:
    """Return the speed in the messages of a position in a JointState: `velocity[...]`; None for other positions."""
    name, _, joint = position.field.text.partition("[") if isinstance(position, Signal) else ("", "", "")
    if not isinstance(position, Signal) or (position.type, name) != ("sensor_msgs/msg/JointState", "position"):
        return None
    return replace(position, name="speed", field=FieldPath.parse(f"velocity[{joint}"))


def align_speed(block: Recording) -> Recording:
    """Return a block whose speed has the stamps of the position, in whose messages it is written."""
    speed, position = block.channels.get("speed"), block.channels["position"]
    if speed is None or np.array_equal(speed.stamps_ns, position.stamps_ns):
        return block
    known = speed.in_order()
    outside = (position.stamps_ns < known.stamps_ns[0]) | (position.stamps_ns > known.stamps_ns[-1])
    values = np.where(outside, np.nan, np.interp(position.stamps_ns, known.stamps_ns, known.values))
    moved = replace(speed, stamps_ns=position.stamps_ns, values=values)
    return replace(block, channels={**block.channels, "speed": moved})
