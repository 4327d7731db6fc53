"""Where least is known, in words and numbers: ranges of stroke, speed, current and history."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ces_iterate.design.features import STATE
from ces_iterate.design.information import KNOWN_VARIANCE
from ces_iterate.design.pool import Pool

F = NDArray[np.float64]

PARTS = 6  # of each axis, with equally many targets
HISTORY = {"change of speed": "speed against its last 20 ms", "change of current": "current against its last 20 ms"}


@dataclass(frozen=True)
class Region:
    """A range of one axis, in `unit`, with its unknown share of the force relative to the mean of all targets."""

    axis: str
    unit: str
    low: float
    high: float
    unknown: float
    coverage: float

    def to_mapping(self) -> dict[str, object]:
        """Return the region for a file."""
        return asdict(self)


def least_known(pool: Pool, unknown: F, variance: F) -> list[Region]:
    """Return the least known range of each axis.

    `unknown` (targets,) is the relative variance that the design lowers, `variance` (targets,) that of the features.
    """
    axes = {
        "stroke": ("m", pool.stroke_m), "speed": ("m/s", pool.speed_m_s), "current": ("A", pool.current_A),
        **{name: ("of the range", pool.state[:, STATE.index(key)]) for key, name in HISTORY.items()},
    }  # fmt: skip
    return [_worst(name, unit, values, unknown, variance) for name, (unit, values) in axes.items()]


def _worst(axis: str, unit: str, values: F, unknown: F, variance: F) -> Region:
    edges = np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1))
    part = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, PARTS - 1)
    means = np.array([unknown[part == k].mean() if (part == k).any() else 0.0 for k in range(PARTS)])
    worst = int(np.argmax(means))
    relative = float(means[worst] / max(float(unknown.mean()), 1e-300))
    known = float(np.mean(variance[part == worst] <= KNOWN_VARIANCE))
    return Region(axis, unit, float(edges[worst]), float(edges[worst + 1]), relative, known)
