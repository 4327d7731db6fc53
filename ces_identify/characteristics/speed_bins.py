"""Force over speed of any motion: quantiles of the force in bins of speed, for each level or range of current.

Needs no cycles, so it also describes noise and roads. Lags, stroke and history spread the forces; the quantiles show
by how much. Where the current keeps to a few levels the samples of steady current are grouped by level, elsewhere into
equal ranges of current.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ces_identify.characteristics.conditions import group_values
from ces_identify.characteristics.cycles import steady_current
from ces_identify.characteristics.motion import Stretch
from ces_identify.numerics.arrays import F, I, Mask

BINS = 32
RANGES = 4
MAX_LEVELS = 12
MIN_STEADY = 0.5  # share of samples at a steady current, for levels
RANGE_QUANTILE = 0.998  # of |speed|, the edge of the outermost bins
MIN_SAMPLES = 30
MIN_VISITS = 3  # separate passes through a bin: samples of one pass are not independent
QUANTILES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class BinnedForce:
    """One bin: `current_A` and `speed_m_s` as (low, high), and the QUANTILES of the force [N]."""

    current_A: tuple[float, float]
    speed_m_s: tuple[float, float]
    samples: int
    visits: int
    force_N: tuple[float, float, float]


def bin_forces(stretches: Sequence[Stretch], source: str, tolerance_A: float) -> list[BinnedForce]:
    """Return the bins with enough samples and visits, by current and speed."""
    current, speed, force, steady = (_join(stretches, source, tolerance_A, k) for k in range(4))
    if not len(speed):
        return []
    reach = float(np.quantile(np.abs(speed), RANGE_QUANTILE))
    edges = np.linspace(-reach, reach, BINS + 1)
    cell = np.clip(np.searchsorted(edges, speed, side="right") - 1, -1, BINS)
    results = []  # the groups are those of the recording, also where a simulation has no force yet
    for low, high, members in _current_groups(current, steady.astype(np.bool_), np.isfinite(current), tolerance_A):
        results += _fill_bins(edges, cell, members & np.isfinite(force), force, (low, high))
    return results


def _current_groups(current: F, steady: Mask, known: Mask, tolerance: float) -> list[tuple[float, float, Mask]]:
    """Return (lowest, highest, members (n,)) of each level, or of each range if there are no levels."""
    held = known & steady
    if held.sum() >= MIN_STEADY * known.sum():
        groups = group_values(np.where(held, current, np.nan)[held], tolerance)
        if len(groups) <= MAX_LEVELS:
            places = np.flatnonzero(held)
            return [_as_group(current, places[group]) for group in groups]
    low, high = np.percentile(current[known], (1.0, 99.0)) if known.any() else (0.0, 0.0)
    edges = np.linspace(low, high, RANGES + 1)
    return [
        (float(a), float(b), known & (current >= a) & (current < b if b < high else current <= b))
        for a, b in pairwise(edges)
    ]


def _as_group(current: F, places: I) -> tuple[float, float, Mask]:
    members = np.zeros(len(current), np.bool_)
    members[places] = True
    return float(current[places].min()), float(current[places].max()), members


def _fill_bins(edges: F, cell: I, members: Mask, force: F, current: tuple[float, float]) -> list[BinnedForce]:
    places = np.flatnonzero(members & (cell >= 0) & (cell < len(edges) - 1))
    if not len(places):
        return []
    order = places[np.argsort(cell[places], kind="stable")]
    bins, starts = np.unique(cell[order], return_index=True)
    filled = []
    for index, inside in zip(bins, np.split(order, starts[1:]), strict=True):
        visits = 1 + int((np.diff(inside) > 1).sum())
        if len(inside) >= MIN_SAMPLES and visits >= MIN_VISITS:
            low, middle, high = (float(q) for q in np.quantile(force[inside], QUANTILES))
            speeds = (float(edges[index]), float(edges[index + 1]))
            filled.append(BinnedForce(current, speeds, len(inside), visits, (low, middle, high)))
    return filled


def _join(stretches: Sequence[Stretch], source: str, tolerance: float, which: int) -> F:
    """Return one column of all samples: current, speed, force, or whether the current is steady."""
    columns = (
        lambda s: s.current,
        lambda s: s.speed,
        lambda s: s.forces[source],
        lambda s: steady_current(s, tolerance).astype(np.float64),
    )
    return np.concatenate([np.empty(0), *(columns[which](s) for s in stretches)])
