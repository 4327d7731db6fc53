"""Changes put into measured recordings, and parameters of the machines read from them, for `real_gaps.py`.

The changes use forms of their own where several exist. Parameters (`read_...`) are read from the signals directly,
without a diagnosis, for the tables.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.gaps.simulations import SPEED_HZ, StaticMap, columns_of, low_pass, rate_of, stop_operator
from ces_data.recording import Recording

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


SLACK = 0.1  # of the limit force: below, a joint counts as open
MOVES_HZ = 20.0  # [Hz] low-pass of a position in which reversals are searched
MIN_REVERSAL = 0.7  # of the median stroke between reversals: shorter ones are run-in and run-out
TURNED = 0.8  # of the change of force after a reversal: elasticity and play are crossed
SLIDES = 0.3  # of the highest speed: above, a damper has left its friction loop
DELAYS_S = tuple(5e-4 * k for k in range(41))  # [s] that are tried


def read_play(recording: Recording) -> float:
    """Return the play [m]: the median stroke on which the force, crossing zero, is within SLACK of its limit."""
    position, force, turns = _position_force_turns(recording)
    limit = float(np.median(np.abs(force)))
    widths = []
    for begin, end in pairwise(turns):
        inside = np.flatnonzero(np.abs(force[begin:end]) < SLACK * limit)
        if len(inside):
            widths.append(float(np.ptp(position[begin:end][inside])))
    return float(np.median(widths))


def read_friction(recording: Recording) -> float:
    """Return the friction [N]: half the step of F = o + c v + f sgn(v), fitted above 0.3 of the highest speed."""
    speed, _, force = columns_of(recording)
    slides = np.abs(speed) > SLIDES * np.abs(speed).max()
    features = np.stack([np.ones_like(speed), speed, np.sign(speed)], axis=1)
    return float(np.linalg.lstsq(features[slides], force[slides], rcond=None)[0][2])


def read_loop_stiffness(recording: Recording) -> float:
    """Return the median stiffness [N/m] from each reversal until TURNED of the force's change to mid-stroke is done."""
    position, force, turns = _position_force_turns(recording)
    found = []
    for begin, end in pairwise(turns):
        change = force[(begin + end) // 2] - force[begin]
        done = np.flatnonzero((force[begin:end] - force[begin]) / change > TURNED)
        if len(done) and position[begin + done[0]] != position[begin]:
            found.append(float(TURNED * change / (position[begin + done[0]] - position[begin])))
    return float(np.median(found))


def read_offset(recording: Recording) -> float:
    """Return the force [N] half way between those of both directions."""
    return 0.5 * float(sum(np.percentile(recording.channel("force").values, (1.0, 99.0))))


def read_valve_delay(recording: Recording) -> float:
    """Return the delay [s] of the control with which a static map of speed and control fits all of the force best."""
    costs = {by_s: _misfit(delay_channel(recording, "current", by_s)) for by_s in DELAYS_S}
    return min(costs, key=lambda by_s: costs[by_s])


def _misfit(recording: Recording) -> float:
    """Return the RMS [N] that a static map leaves."""
    position, current, force = (recording.channel(n) for n in ("position", "current", "force"))
    seconds = 1e-9 * (position.stamps_ns - position.stamps_ns[0])
    simulated = StaticMap.fit(recording, 0.0)(seconds, position.values, current.values)
    return float(np.sqrt(np.mean((force.values - simulated) ** 2)))


def _position_force_turns(recording: Recording) -> tuple[F, F, Sequence[int]]:
    """Return position [m] and force [N] (n,), and the ticks of full reversals."""
    position, force = recording.channel("position").values, recording.channel("force").values
    smooth = low_pass(position, MOVES_HZ, rate_of(recording))
    turns = np.flatnonzero(np.diff(np.gradient(smooth) >= 0.0))
    strokes = np.abs(np.diff(smooth[turns]))
    full = strokes > MIN_REVERSAL * float(np.percentile(strokes, 95))
    kept = [int(t) for t, before, after in zip(turns[1:-1], full[:-1], full[1:], strict=True) if before and after]
    return smooth, force, kept
