"""Parameters of measured machines read from signals directly, without a diagnosis, for the tables of `real_gaps.py`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.gaps.current_maps import columns_of
from bench.gaps.effects import delay_channel
from bench.gaps.simulations import StaticMap, low_pass, rate_of
from ces_identify.recordings.recording import Recording

F = NDArray[np.float64]

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
