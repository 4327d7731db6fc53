"""Maps of the gap over two axes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ces_gap.trace import F
from ces_gap.where.axes import (
    CURRENT,
    REVERSAL,
    SPEED,
    STROKE,
    axis_edges,
    even_edges,
    is_constant,
    region_indices,
    whole_range,
)
from ces_gap.where.regions import GapMap

MAPS = ((SPEED, STROKE), (SPEED, CURRENT), (SPEED, REVERSAL))
FIELDS = {SPEED: 16, STROKE: 12, CURRENT: 8}  # approximate number along an axis
MIN_FIELD_TICKS = 25  # a field with fewer is left empty


def compute_gap_maps(values: Mapping[str, F], energy: F) -> tuple[GapMap, ...]:
    """Return the maps of a gap's energy [N²] (n,), without noise, over axes with these values (n,)."""
    return tuple(_map(axes, values, energy) for axes in MAPS)


def _map(axes: tuple[str, str], values: Mapping[str, F], energy: F) -> GapMap:
    edges = _edges(axes[0], values[axes[0]]), _edges(axes[1], values[axes[1]])
    a, b = (region_indices(e, values[name]) for e, name in zip(edges, axes, strict=True))
    shape = len(edges[1]) - 1, len(edges[0]) - 1
    field = b * shape[1] + a
    samples = np.bincount(field, minlength=shape[0] * shape[1]).astype(np.float64)
    total = np.bincount(field, energy, minlength=shape[0] * shape[1])
    shown = samples >= MIN_FIELD_TICKS
    rms = np.sqrt(np.maximum(total, 0.0) / np.maximum(samples, 1.0))
    return GapMap(axes, edges, np.where(shown, rms, np.nan).reshape(shape), samples.reshape(shape))


def _edges(axis: str, values: F) -> F:
    if is_constant(values):
        return whole_range(values)
    if axis == REVERSAL:
        return axis_edges(axis, values)
    return even_edges(values, FIELDS[axis])
