"""The family of force over speed at constant currents, at mid-stroke: simulated, and medians of the measured force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_data.arrays import F, I
from ces_identify.limits import EnvelopeLimits
from ces_identify.physical.quantities import curve_currents, curve_speeds
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import is_outside
from ces_identify.structures import run_batch
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Model
from ces_observer.structures.structure import Range
from ces_report.table import Section
from ces_report.typesetting import Chart, ChartCurve, minus

RESTS = 2.0  # times the warm-up, for which the damper rests before a stroke
CURVE_SPEEDS, MEDIANS = 20, 16  # on each side of zero, and of the measured force at a current
MIN_TICKS = 10  # of a median
DECIMALS = 9  # of a current [A]: rounding of the envelope
NEAR_A = 0.05  # [A] of a current, at most: a valve's force changes by a few percent in it
SPEED = "Speed [m/s], positive in compression"
STEADY = (
    "Force at constant speed and current at mid-stroke, simulated. Dots: median of the measured force there, within "
    "a quarter of the stroke and near that current. Dashed: speeds beyond those recorded."
)


def steady_section(model: Model, evaluations: Sequence[Evaluation]) -> Section:
    """Return the family of force over speed at currents that the model knows, with measured medians."""
    series = [e.series for e in evaluations]
    speeds, currents = curve_speeds(*model.envelope.speed_m_s, CURVE_SPEEDS), recorded_currents(model)
    curves = []
    for current, forces in zip(currents, steady_forces(model, currents, speeds), strict=True):
        points = measured_medians(series, current, currents, model.envelope.position_m)
        recorded = (float(points[0].min()), float(points[0].max())) if len(points[0]) else (0.0, 0.0)
        name = minus(f"{current:.3g} A")
        curves.append(ChartCurve(name, speeds, forces, np.zeros(len(speeds)), recorded, points))
    chart = Chart("Force over speed", SPEED, "Force [N]", tuple(curves), STEADY)
    return Section("force-speed", "Force over speed at constant currents", charts=(chart,))


def recorded_currents(model: Model) -> F:
    """Return currents [A] from the lowest to the highest in the identification data, which the envelope exceeds."""
    low, high = model.envelope.current_A
    margin = EnvelopeLimits.INPUT_MARGIN / (1.0 + 2.0 * EnvelopeLimits.INPUT_MARGIN) * (high - low)
    currents = np.clip(np.round(curve_currents(low + margin, high - margin), DECIMALS), low, high)
    return np.asarray(currents[~is_outside(model, "current", currents)]) + 0.0  # no -0


def measured_medians(series: Sequence[Series], current: float, currents: F, stroke: Range) -> tuple[F, F]:
    """Return medians of speed and measured force in bins of the speed, near a current and the middle of the stroke."""
    near = 0.5 * float(np.min(np.diff(currents), initial=np.inf))
    middle, quarter = 0.5 * sum(stroke), 0.25 * (stroke[1] - stroke[0])
    masks = [
        s.scored & (np.abs(s.current - current) <= min(near, NEAR_A)) & (np.abs(s.position - middle) <= quarter)
        for s in series
    ]
    speed, force = (
        np.concatenate([getattr(s, name)[m] for s, m in zip(series, masks, strict=True)]) for name in ("speed", "force")
    )
    if len(speed) < MIN_TICKS:
        return np.empty(0), np.empty(0)
    edges = np.quantile(speed, np.linspace(0.0, 1.0, MEDIANS + 1))
    bins = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, MEDIANS - 1)
    used = [bins == n for n in range(MEDIANS) if (bins == n).sum() >= MIN_TICKS]
    return np.array([np.median(speed[b]) for b in used]), np.array([np.median(force[b]) for b in used])


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
