"""The force of a model at constant speeds and currents, at mid-stroke: its family of force over speed."""

from __future__ import annotations

import numpy as np

from ces_data.arrays import F, I
from ces_identify.structures import run_batch
from ces_observer.model import Model

RESTS = 2.0  # times the warm-up, for which the damper rests before a stroke


def steady_forces(model: Model, currents: F, speeds: F) -> F:
    """Return the force [N] (currents, speeds) at mid-stroke, at the end of a stroke at constant speed and current.

    Each stroke begins at rest, as far from the middle as the speed [m/s] goes in half the stroke that the model knows.
    """
    strokes = [_stroke(model, current, speed) for current in currents for speed in speeds]
    ends = np.cumsum([stroke.shape[1] for stroke in strokes])
    segments: I = np.column_stack([np.append(0, ends[:-1]), ends])
    force, _ = run_batch(model, np.concatenate(strokes, axis=1), segments)
    return np.asarray(force[ends - 1].reshape(len(currents), len(speeds)))


def _stroke(model: Model, current: float, speed: float) -> F:
    """Return the inputs (3, ticks) of a stroke after a rest."""
    low, high = model.envelope.position_m
    rate, half = model.sampling.rate_Hz, 0.5 * (high - low)
    ticks = int(min(half / abs(speed), model.warm_up_s) * rate) if speed else 0
    moving = 0.5 * (low + high) + speed / rate * np.arange(-ticks, 1)
    rest = round(RESTS * model.warm_up_s * rate)
    position = np.concatenate([np.full(rest, moving[0]), moving])
    return np.stack([position, np.where(np.arange(len(position)) > rest, speed, 0.0), np.full(len(position), current)])
