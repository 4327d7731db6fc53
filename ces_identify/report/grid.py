"""The distribution of time and error over speed and current: the numbers of the maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, Mask
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Envelope

SPEEDS, CURRENTS = 30, 14  # cells
MIN_TICKS = 10  # of a cell with an error
SAME_CURRENT = 0.01  # of the largest current: a narrower range counts as constant


@dataclass(frozen=True)
class SpeedCurrentGrid:
    """Edges of the cells in speed [m/s] and current [A], as (SPEEDS + 1,) and (CURRENTS + 1,); (2,) if constant."""

    speed: F
    current: F

    @property
    def one_current(self) -> bool:
        """Whether the current is constant, so that the maps show speed only."""
        return len(self.current) == 2

    def share(self, evaluations: Sequence[Evaluation]) -> F:
        """Return the share of the scored time [%] spent in each cell, shape (speeds, currents)."""
        ticks = sum((self._sum(e, e.series.scored, None) for e in evaluations), start=self._zeros())
        return np.asarray(100.0 * ticks / max(float(ticks.sum()), 1.0))

    def rms(self, evaluations: Sequence[Evaluation]) -> F:
        """Return the RMS error [N] in each cell, NaN where there are too few ticks."""
        ticks, squares = self._zeros(), self._zeros()
        for e in evaluations:
            mask = e.series.scored & np.isfinite(e.run.force)
            ticks += self._sum(e, mask, None)
            squares += self._sum(e, mask, (e.series.force[mask] - e.run.force[mask]) ** 2)
        enough = ticks >= MIN_TICKS
        return np.where(enough, np.sqrt(squares / np.maximum(ticks, 1.0)), np.nan)

    def _sum(self, evaluation: Evaluation, mask: Mask, weights: F | None) -> F:
        series = evaluation.series
        edges = (self.speed, self.current)
        return np.histogram2d(series.speed[mask], series.current[mask], bins=edges, weights=weights)[0]

    def _zeros(self) -> F:
        return np.zeros((len(self.speed) - 1, len(self.current) - 1))


def make_grid(evaluations: Sequence[Evaluation], envelope: Envelope) -> SpeedCurrentGrid:
    """Return a grid over the model's envelope and all speeds and currents of the scored ticks."""
    speed = np.concatenate([e.series.speed[e.series.scored] for e in evaluations])
    current = np.concatenate([e.series.current[e.series.scored] for e in evaluations])
    speed, low, high = np.append(speed, envelope.speed_m_s), float(current.min()), float(current.max())
    if high - low <= SAME_CURRENT * max(abs(low), abs(high), 1e-9):
        currents = np.array([low - 1e-6, high + 1e-6])
    else:
        currents = _edges(min(low, envelope.current_A[0]), max(high, envelope.current_A[1]), CURRENTS)
    return SpeedCurrentGrid(_edges(speed.min(), speed.max(), SPEEDS), currents)


def _edges(low: float, high: float, cells: int) -> F:
    return np.linspace(low, max(high, low + 1e-9), cells + 1)
