"""How much of the measured force a model's band holds: by speed, current and time since the last reversal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ces_identify.numerics.arrays import F, Mask
from ces_identify.simulations.band_run import since_reversal
from ces_identify.validation.evaluate import Evaluation

SPEEDS, CURRENTS = 4, 3  # regions
QUANTILE = 0.995  # of |speed| at the limit of the fastest region, which also holds faster ticks
REVERSAL_EDGES_S = (0.01, 0.05)
MIN_TICKS = 50  # of a region


@dataclass(frozen=True)
class CoverageShare:
    """A region's share of the ticks, the share of its measured forces within the band, and the mean half-width [N]."""

    axis: str
    region: str
    ticks: float
    coverage: float
    half_width_N: float


def coverage_regions(evaluations: Sequence[Evaluation]) -> list[CoverageShare]:
    """Return the regions of speed, current and time since reversal with at least MIN_TICKS ticks.

    Empty without a band. Ticks after a divergence count as outside the band.
    """
    some = [e for e in evaluations if e.half_width is not None and e.series.scored.any()]
    if not some:
        return []
    width = _collect(some, lambda e: np.nan_to_num(np.zeros(0) if e.half_width is None else e.half_width))
    inside = _collect(some, lambda e: np.abs(e.series.force - e.run.force)) <= width
    return [
        CoverageShare(axis, region, float(ticks.mean()), float(inside[ticks].mean()), float(width[ticks].mean()))
        for axis, region, ticks in _regions(some)
        if ticks.sum() >= MIN_TICKS
    ]


def _regions(evaluations: Sequence[Evaluation]) -> Iterator[tuple[str, str, Mask]]:
    """Yield axis, name and ticks of each region."""
    speed = np.abs(_collect(evaluations, lambda e: e.series.speed))
    current = _collect(evaluations, lambda e: e.series.current)
    top, (low, high) = float(np.quantile(speed, QUANTILE)), (float(current.min()), float(current.max()))
    yield from _divide("speed, either direction", "m/s", speed, np.linspace(0.0, top, SPEEDS + 1)[1:-1])
    if high > low:
        yield from _divide("current", "A", current, np.linspace(low, high, CURRENTS + 1)[1:-1])
    since = _collect(evaluations, lambda e: since_reversal(e.series))
    yield from _divide("time since reversal", "s", since, np.array(REVERSAL_EDGES_S))


def _divide(axis: str, unit: str, values: F, inner_edges: F) -> Iterator[tuple[str, str, Mask]]:
    edges = [-np.inf, *inner_edges.tolist(), np.inf]
    for low, high in pairwise(edges):
        name = f"{low:.3g} to {high:.3g}" if low > -np.inf and high < np.inf else ""
        name = name or (f"below {high:.3g}" if high < np.inf else f"above {low:.3g}")
        yield axis, f"{name} {unit}", (values >= low) & (values < high)


def _collect(evaluations: Sequence[Evaluation], signal: Callable[[Evaluation], F]) -> F:
    """Return a signal on the scored ticks of all evaluations."""
    return np.concatenate([signal(e)[e.series.scored] for e in evaluations])
