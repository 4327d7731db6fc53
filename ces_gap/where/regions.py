"""Where a gap lies, as records: regions of an axis, maps over two axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.explanation import Interval

F = NDArray[np.float64]


@dataclass(frozen=True)
class GapRegion:
    """One region of one axis; `low` and `high` in the axis' unit. `share_of_energy` of the noise-corrected gap.

    `q_value` is the false-discovery rate at which the region's mean energy exceeds the rest of its axis.
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
    """The gap over two axes: `rms_N` (b, a), NaN where fewer than enough samples lie; edges (a+1,), (b+1,)."""

    axes: tuple[str, str]
    edges: tuple[F, F]
    rms_N: F
    samples: F


@dataclass(frozen=True)
class Where:
    """Regions of all axes, most energy first; the largest standardised excess over regions and its p-value; maps."""

    regions: tuple[GapRegion, ...]
    strongest: GapRegion | None
    max_p_value: float
    maps: tuple[GapMap, ...]
