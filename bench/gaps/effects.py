"""Known changes for real recordings, each in a form that `ces_gap` does not use, for `real_gaps.py`.

A change takes a measured recording and returns it as if logged with another rig or another damper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.gaps.simulations import SPEED_HZ, low_pass, rate_of, stop_operator
from ces_identify.recordings.recording import Recording

F = NDArray[np.float64]

FRICTION_N, TRAVELS_M = 200.0, (5e-5, 2e-4, 8e-4)
VALVE_LAG_S = 8e-3
POSITION_DELAY_S = 1.2e-3
GAIN = 1.2
MASS_KG = 12.0


@dataclass(frozen=True)
class Change:
    """A change: the effect that a diagnosis should name, a description, and the function."""

    effect: str
    words: str
    apply: Callable[[Recording], Recording]


def with_values(recording: Recording, name: str, values: F) -> Recording:
    """Return the recording with other values (n,) in a channel."""
    channel = replace(recording.channel(name), values=values)
    return replace(recording, channels={**recording.channels, name: channel}, source="", sha256="")


def delay_channel(recording: Recording, name: str, by_s: float) -> Recording:
    """Return the recording with a channel delayed by `by_s`."""
    channel = recording.channel(name)
    time = 1e-9 * (channel.stamps_ns - channel.stamps_ns[0])
    return with_values(recording, name, np.interp(time - by_s, time, channel.values))


def add_force(recording: Recording, force: F) -> Recording:
    return with_values(recording, "force", recording.channel("force").values + force)


def add_friction(recording: Recording) -> Recording:
    """Add three springs with sliders (Iwan) that slip one after the other; `ces_gap` has one smooth curve."""
    position = low_pass(recording.channel("position").values, SPEED_HZ, rate_of(recording))
    share = FRICTION_N / len(TRAVELS_M)
    return add_force(recording, sum(stop_operator(position, share / x, -share, share) for x in TRAVELS_M))


def add_mass(recording: Recording) -> Recording:
    """Add a mass on the piston's side of the cell; acceleration up to 80 Hz, where the position's noise begins."""
    rate = rate_of(recording)
    position = low_pass(recording.channel("position").values, SPEED_HZ, rate)
    return add_force(recording, MASS_KG * rate**2 * np.gradient(np.gradient(position)))


def scale_force(recording: Recording) -> Recording:
    return with_values(recording, "force", GAIN * recording.channel("force").values)


CHANGES = (
    Change("friction", f"{FRICTION_N:.0f} N, let go after 0.05, 0.2 and 0.8 mm", add_friction),
    Change(
        "valve_lag", f"{1e3 * VALVE_LAG_S:.0f} ms of dead time", lambda r: delay_channel(r, "current", -VALVE_LAG_S)
    ),
    Change(
        "position_delay",
        f"position logged {1e3 * POSITION_DELAY_S:.1f} ms late",
        lambda r: delay_channel(r, "position", POSITION_DELAY_S),
    ),
    Change("force_scale", f"force cell reads {100.0 * (GAIN - 1.0):.0f} % more", scale_force),
    Change("inertia", f"{MASS_KG:.0f} kg between cell and piston", add_mass),
)
