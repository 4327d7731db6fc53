"""The axes along which a gap is located: values at every tick, readable edges of regions, and maps over two axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I
from ces_gap.grid import rms
from ces_gap.inference.fit import Interval
from ces_gap.limits import DiagnosisLimits, RegionLimits
from ces_gap.trace import Trace


@dataclass(frozen=True)
class GapRegion:
    """One region from `low` to `high` of an axis, in its unit; `share_of_energy` of the gap without noise.

    `q_value` is the false-discovery rate at which the region's mean energy exceeds that of the rest of its axis.
    """

    axis: str
    low: float
    high: float
    share_of_energy: float
    share_of_samples: float
    rms_N: float
    ci95_N: Interval
    q_value: float


@dataclass(frozen=True)
class GapMap:
    """The gap over two axes: `rms_N` (b, a), NaN where there are too few ticks; edges (a+1,), (b+1,)."""

    axes: tuple[str, str]
    edges: tuple[F, F]
    rms_N: F


@dataclass(frozen=True)
class Where:
    """Regions of all axes, largest energy first; the one with the largest standardised excess, its p-value; maps."""

    regions: tuple[GapRegion, ...]
    strongest: GapRegion | None
    max_p_value: float
    maps: tuple[GapMap, ...]


STROKE, SPEED, CURRENT, DIRECTION = "stroke_m", "speed_m_s", "current_A", "direction"
FREQUENCY, REVERSAL, ELAPSED, HEAT = "frequency_hz", "since_reversal_s", "elapsed_s", "heat_J"
OPERATING = (STROKE, SPEED, CURRENT, DIRECTION, REVERSAL, ELAPSED, HEAT)  # known tick by tick

QUANTILES = (0.005, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98, 0.995)  # rare extremes get their own regions
SPEED_QUANTILES = (0.15, 0.4, 0.7, 0.9, 0.97, 0.993)  # of its magnitude: the edges are symmetric
REVERSAL_EDGES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # [s]
FINEST = 500.0  # edges are rounded to no less than the axis' range over this
MAPS = ((SPEED, STROKE), (SPEED, CURRENT), (SPEED, REVERSAL))
FIELDS = {SPEED: 16, STROKE: 12, CURRENT: 8}  # approximate number along an axis


def axis_values(trace: Trace) -> dict[str, F]:
    """Return the value of each operating axis at every tick (n,), SI; `direction` is +1 in compression, −1 in rebound.

    `since_reversal_s` counts from the last reversal or the first tick; `heat_J` is the work |F v| since the first tick.
    """
    direction, since = reversals(trace)
    power = np.abs(np.where(trace.usable, trace.force, trace.simulated) * trace.inputs.speed)
    return {
        STROKE: trace.inputs.position,
        SPEED: trace.inputs.speed,
        CURRENT: trace.inputs.current,
        DIRECTION: direction,
        REVERSAL: since,
        ELAPSED: trace.time_s,
        HEAT: np.cumsum(power) * trace.step_s,
    }


def reversals(trace: Trace) -> tuple[F, F]:
    """Return the direction of motion (n,), ±1, and the time since the last reversal [s] (n,).

    A sign change counts only if the speed then exceeds a hysteresis, so that noise near standstill does not count. Its
    time is that of the zero crossing.
    """
    speed = trace.inputs.speed
    width = max(RegionLimits.HYSTERESIS * rms(speed[trace.usable]), RegionLimits.MIN_HYSTERESIS_M_S)
    sure = np.flatnonzero(np.abs(speed) > width)
    if not len(sure):
        return np.ones(len(speed)), trace.time_s - trace.time_s[0]
    sides = np.sign(speed[sure])
    turned = sure[1:][sides[1:] != sides[:-1]]
    crossings = 1 + np.flatnonzero(np.sign(speed[1:]) != np.sign(speed[:-1]))
    at = np.concatenate([[0], crossings[np.searchsorted(crossings, turned, side="right") - 1]])
    last = np.searchsorted(at, np.arange(len(speed)), side="right") - 1
    return sides[0] * (-1.0) ** last, trace.time_s - trace.time_s[at[last]]


def axis_edges(axis: str, values: F) -> F:
    """Return the edges (m+1,) of an axis' regions from its values (n,) on the usable ticks of all recordings."""
    if axis == DIRECTION:
        edges = np.array([-1.0, 0.0, 1.0])
    elif is_constant(values):  # a single region
        low, high = float(values.min()), float(values.max())
        step = round_to_one_two_five(max(abs(low), abs(high), 1e-3) * DiagnosisLimits.CONSTANT, up=True)
        first, last = np.floor(low / step + 1e-6), np.ceil(high / step - 1e-6)
        return _decimal(np.array([first, max(last, first + 1.0)]), step)
    elif axis == REVERSAL:
        inner = [e for e in REVERSAL_EDGES if e < float(values.max())]
        edges = np.array([*inner, round_to_one_two_five(float(values.max()), up=True)])
    elif axis in (ELAPSED, HEAT):
        edges = even_edges(values, 8)
    elif axis == SPEED:
        half = _readable(np.quantile(np.abs(values), (0.0, *SPEED_QUANTILES, 1.0)))[1:]
        edges = np.concatenate([-half[::-1], half])
    else:
        levels = _levels(values)
        edges = _readable(np.quantile(values, (0.0, *QUANTILES, 1.0)) if levels is None else levels)
    return _merge_sparse_regions(edges, values)


def region_indices(edges: F, values: F) -> I:
    """Return the region (n,) of each value; those beyond the outer edges belong to the outer regions."""
    return np.asarray(np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2), dtype=np.int64)


def even_edges(values: F, count: int) -> F:
    """Return about `count` + 1 evenly spaced, readable edges over all values."""
    low, high = float(values.min()), float(values.max())
    ideal = (high - low) / count
    steps = (round_to_one_two_five(ideal, up) for up in (True, False))
    step = min(steps, key=lambda s: abs(np.log(s / ideal)))
    first, last = np.floor(low / step + 1e-6), np.ceil(high / step - 1e-6)
    return _decimal(np.arange(first, last + 1.0), step)


def is_constant(values: F) -> bool:
    """Return whether an axis varies too little to be divided."""
    return float(np.ptp(values)) <= DiagnosisLimits.CONSTANT * max(float(np.abs(values).max()), 1e-9)


def round_to_one_two_five(value: float, up: bool) -> float:
    """Return the next larger or smaller number of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(value, 1e-12)))
    steps = np.array([1.0, 2.0, 5.0, 10.0]) * power
    fits = steps[steps >= value * (1 - 1e-9)] if up else steps[steps <= value * (1 + 1e-9)][::-1]
    return float(fits[0])


def _levels(values: F) -> F | None:
    """Return edges midway between the levels of a quantity with only a few, None if it has many."""
    grid = float(np.ptp(values)) / 100.0
    _, group, counts = np.unique(np.round(values / grid), return_inverse=True, return_counts=True)
    frequent = np.flatnonzero(counts >= max(RegionLimits.MIN_SHARE * len(values), RegionLimits.MIN_TICKS))
    if not 2 <= len(frequent) <= RegionLimits.FEW_LEVELS or counts[frequent].sum() < 0.9 * len(values):
        return None
    levels = [float(np.median(values[group == k])) for k in frequent]
    return np.array([values.min(), *(np.diff(levels) / 2.0 + levels[:-1]), values.max()])


def _readable(edges: F) -> F:
    """Return increasing edges rounded to about a third of the distance to their neighbours, the outer ones outwards."""
    finest = float(edges[-1] - edges[0]) / FINEST
    gaps = np.maximum(np.diff(edges), finest)
    room = np.minimum(np.concatenate([gaps[:1], gaps]), np.concatenate([gaps, gaps[-1:]]))
    rounded = []
    for k, (edge, space) in enumerate(zip(edges, room, strict=True)):
        step = round_to_one_two_five(max(space / 3.0, finest), up=False)
        whole = {0: np.floor, len(edges) - 1: np.ceil}.get(k, np.round)
        rounded.append(float(_decimal(whole(np.array([edge / step]) - (1e-9 if k else -1e-9)), step)[0]))
    return np.unique(rounded)


def _merge_sparse_regions(edges: F, values: F) -> F:
    """Return the edges after merging each region with too few ticks into its smaller neighbour."""
    min_ticks = max(RegionLimits.MIN_SHARE * len(values), RegionLimits.MIN_TICKS)
    while len(edges) > 2:
        counts = np.bincount(region_indices(edges, values), minlength=len(edges) - 1)
        small = int(np.argmin(counts))
        if counts[small] >= min_ticks:
            break
        before, _, after = np.pad(counts.astype(np.float64), 1, constant_values=np.inf)[small : small + 3]
        edges = np.delete(edges, small if before <= after else small + 1)
    return edges


def _decimal(multiples: F, step: float) -> F:
    """Return multiples of a step without binary rounding errors."""
    return np.round(multiples * step, max(0, 2 - int(np.floor(np.log10(step))))) + 0.0  # no negative zero


def compute_gap_map(axes: tuple[str, str], values: Mapping[str, F], energy: F) -> GapMap:
    """Return the map of a gap's energy [N²] (n,), without noise, over two axes with these values (n,)."""

    def edges_of(axis: str) -> F:
        if axis == REVERSAL or is_constant(values[axis]):
            return axis_edges(axis, values[axis])
        return even_edges(values[axis], FIELDS[axis])

    edges = edges_of(axes[0]), edges_of(axes[1])
    a, b = (region_indices(e, values[name]) for e, name in zip(edges, axes, strict=True))
    shape = len(edges[1]) - 1, len(edges[0]) - 1
    field = b * shape[1] + a
    ticks, total = (np.bincount(field, w, minlength=shape[0] * shape[1]) for w in (np.ones(len(field)), energy))
    rms = np.sqrt(np.maximum(total, 0.0) / np.maximum(ticks, 1.0))
    return GapMap(axes, edges, np.where(ticks >= RegionLimits.MIN_TICKS, rms, np.nan).reshape(shape))
