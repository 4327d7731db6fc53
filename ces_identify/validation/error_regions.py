"""The distribution of a free run's error: by speed and current, direction, zero crossing and stroke."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ces_identify.numerics.arrays import F, I, Mask
from ces_identify.preparation.weighting import CENTRAL, SLOW_M_S
from ces_identify.validation.evaluate import Evaluation

SPEEDS, CURRENTS = 6, 3  # cells of the coarse table
QUANTILE = 0.995  # of |speed| at the limit of the outermost cells, which also hold faster ticks
SAME_CURRENT = 0.01  # of the largest current: a narrower range counts as constant


@dataclass(frozen=True)
class ErrorShare:
    """A region's share of the squared error and of the ticks, its RMS error [N], and its part of J [%].

    The squares of the parts of J of all regions of an `axis` sum to J^2.
    """

    axis: str
    region: str
    energy: float
    ticks: float
    rms_N: float
    cost: float


@dataclass(frozen=True)
class _Scored:
    """Ticks of all evaluations, concatenated; `stroke` is 0 to 1 over all, `spread` the sum of (y - mean y)^2."""

    speed: F
    current: F
    stroke: F
    error: F
    spread: float


def error_cells(evaluations: Sequence[Evaluation]) -> list[ErrorShare]:
    """Return the visited cells of speed and current, or of speed if the current is constant; largest error first."""
    ticks = _collect_scored_ticks(evaluations)
    top = float(np.quantile(np.abs(ticks.speed), QUANTILE)) if len(ticks.speed) else 0.0
    speeds = np.linspace(-top, top, SPEEDS + 1)
    currents = _current_edges(ticks.current)
    v, c = _cell(ticks.speed, speeds), _cell(ticks.current, currents)
    cells = []
    for a, b in product(range(SPEEDS), range(len(currents) - 1)):
        name = f"{_round(speeds[a]):.2f} to {_round(speeds[a + 1]):.2f} m/s"
        if len(currents) > 2:
            name += f", {currents[b]:.2f} to {currents[b + 1]:.2f} A"
        cells.append(_share(ticks, "speed x current", name, (v == a) & (c == b)))
    return sorted((s for s in cells if s.ticks > 0.0), key=lambda s: -s.energy)


def _round(speed: float) -> float:
    """Return a speed of two decimals, without the sign of a zero."""
    return round(float(speed), 2) + 0.0


def error_regions(evaluations: Sequence[Evaluation]) -> list[ErrorShare]:
    """Return the regions of direction, zero crossing and stroke; the regions of an axis cover all ticks."""
    ticks = _collect_scored_ticks(evaluations)
    slow = np.abs(ticks.speed) < SLOW_M_S
    low, high = ticks.stroke < 0.5 - CENTRAL / 2, ticks.stroke > 0.5 + CENTRAL / 2
    masks = {
        "direction": {"compression": ticks.speed >= 0.0, "rebound": ticks.speed < 0.0},
        "zero crossing": {f"|speed| below {SLOW_M_S:g} m/s": slow, "faster": ~slow},
        "stroke": {"rebound end": low, f"central {100 * CENTRAL:.0f} %": ~low & ~high, "compression end": high},
    }
    return [_share(ticks, axis, name, mask) for axis, regions in masks.items() for name, mask in regions.items()]


def _collect_scored_ticks(evaluations: Sequence[Evaluation]) -> _Scored:
    masks = [e.series.scored & np.isfinite(e.run.force) for e in evaluations]
    pairs = list(zip(evaluations, masks, strict=True))

    def concatenate(signal: str) -> F:
        return np.concatenate([np.empty(0), *(getattr(e.series, signal)[k] for e, k in pairs)])

    position = concatenate("position")
    low, span = (float(position.min()), float(np.ptp(position))) if len(position) else (0.0, 1.0)
    error = [e.series.force[k] - e.run.force[k] for e, k in pairs]
    spread = sum(float(((f - f.mean()) ** 2).sum()) for e in evaluations for f in (e.series.force[e.series.scored],))
    stroke = (position - low) / max(span, 1e-12)
    return _Scored(concatenate("speed"), concatenate("current"), stroke, np.concatenate([np.empty(0), *error]), spread)


def _share(ticks: _Scored, axis: str, region: str, mask: Mask) -> ErrorShare:
    squares = ticks.error[mask] ** 2
    inside, energy = float(squares.sum()), float((ticks.error**2).sum())
    return ErrorShare(
        axis,
        region,
        inside / energy if energy > 0.0 else 0.0,
        float(mask.mean()) if len(mask) else 0.0,
        float(np.sqrt(squares.mean())) if len(squares) else 0.0,
        float(100.0 * np.sqrt(inside / ticks.spread)) if ticks.spread > 0.0 else 0.0,
    )


def _cell(values: F, edges: F) -> I:
    return np.clip(np.searchsorted(edges, values, "right") - 1, 0, len(edges) - 2)


def _current_edges(current: F) -> F:
    low, high = (float(current.min()), float(current.max())) if len(current) else (0.0, 0.0)
    constant = high - low <= SAME_CURRENT * max(abs(low), abs(high), 1e-9)
    return np.linspace(low, high, 2 if constant else CURRENTS + 1)
