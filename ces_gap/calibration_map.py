"""The map of a calibration as a table: how much it adds to the simulated force, and at which speed and current."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ces_gap.diagnosis import Diagnosis
from ces_gap.inference.verdict import CALIBRATION
from ces_gap.trace import F

SPEED_SHARES = np.array([0.0, 0.05, 0.35, 0.65, 0.95, 1.0])  # quantiles that bound the cells of speed
CURRENT_SHARES = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
SAME_CURRENT = 0.02  # relative spread below which there is one cell of current
MIN_TICKS = 10


@dataclass(frozen=True)
class CalibrationCell:
    """The mean force [N] that the map adds within ranges of speed [m/s] and current [A]."""

    speed_m_s: tuple[float, float]
    current_A: tuple[float, float]
    force_N: float


def calibration_cells(diagnosis: Diagnosis) -> tuple[CalibrationCell, ...]:
    """Return the cells of the composition's calibration on the held-out recordings; none if it has none."""
    setting = next((s for s in diagnosis.composition.composition.settings if s.name == CALIBRATION), None)
    traces = [s.trace for s in diagnosis.held_out]
    if setting is None or not traces:
        return ()
    maps = [setting.effect.respond(t, t.inputs, np.zeros(len(t)), setting.values) for t in traces]
    added = np.concatenate([m[t.usable] for m, t in zip(maps, traces, strict=True)])
    speed, current = (np.concatenate([getattr(t.inputs, n)[t.usable] for t in traces]) for n in ("speed", "current"))
    speeds, currents = np.quantile(speed, SPEED_SHARES), _current_edges(current)
    rows = [(low, high, _within(speed, low, high)) for low, high in pairwise(speeds)]
    columns = [(low, high, _within(current, low, high)) for low, high in pairwise(currents)]
    return tuple(
        CalibrationCell((float(a), float(b)), (float(c), float(d)), float(added[row & column].mean()))
        for a, b, row in rows
        for c, d, column in columns
        if (row & column).sum() >= MIN_TICKS
    )


def largest_cell(cells: tuple[CalibrationCell, ...]) -> CalibrationCell:
    """Return the cell in which the map adds most."""
    return max(cells, key=lambda c: abs(c.force_N))


def _current_edges(current: F) -> F:
    if current.std() <= SAME_CURRENT * max(abs(float(current.mean())), 1e-9):
        return np.array([current.min(), current.max()])
    return np.asarray(np.quantile(current, CURRENT_SHARES))


def _within(values: F, low: float, high: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((values >= low) & (values <= high))
