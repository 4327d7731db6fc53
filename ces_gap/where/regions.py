"""Records of where a gap lies: regions of an axis, maps over two axes."""

from __future__ import annotations

from dataclasses import dataclass

from ces_gap.inference.explanation import Interval
from ces_gap.trace import F


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
    """The gap over two axes: `rms_N` (b, a), NaN where there are too few samples; edges (a+1,), (b+1,)."""

    axes: tuple[str, str]
    edges: tuple[F, F]
    rms_N: F
    samples: F


@dataclass(frozen=True)
class Where:
    """Regions of all axes, largest energy first; the one with the largest standardised excess, its p-value; maps."""

    regions: tuple[GapRegion, ...]
    strongest: GapRegion | None
    max_p_value: float
    maps: tuple[GapMap, ...]
