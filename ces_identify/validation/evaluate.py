"""Evaluation of a model on a recording: its free run, the measured force, and the cost J."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.preparation.cost import require_force, series_cost
from ces_identify.preparation.series import Series
from ces_identify.simulations.band_run import band_half_width
from ces_identify.simulations.simulate import FreeRun, simulate_series
from ces_identify.validation.envelope_use import RangeUse, describe_outside, outside_ranges
from ces_observer.model import Model

IDENTIFICATION, VALIDATION = "identification", "validation"


@dataclass(frozen=True)
class Evaluation:
    """The free run of a model on one series. `role` is IDENTIFICATION if fit or selection used it, else VALIDATION.

    `half_width` (ticks,) [N] is that of the model's band, None if it has none. `outside` are the signals that leave the
    model's envelope.
    """

    name: str
    role: str
    series: Series
    run: FreeRun
    cost: float
    half_width: F | None = None
    outside: tuple[RangeUse, ...] = ()

    @property
    def error(self) -> F:
        """Measured minus simulated force [N] on the scored ticks, shape (n,)."""
        scored = self.series.scored
        return np.asarray(self.series.force[scored] - self.run.force[scored])

    @property
    def rms_N(self) -> float:
        """Root mean square of the error [N]."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def clamped_share(self) -> float:
        """Share of the scored ticks with inputs outside the model's envelope."""
        return float(self.run.clamped[self.series.scored].mean())

    @property
    def outside_text(self) -> str:
        """The share of the time outside the envelope, with the ranges of the signals; empty if hardly any."""
        return describe_outside(self.name, self.clamped_share, self.outside) if self.outside else ""

    @property
    def coverage(self) -> float | None:
        """Share of the scored ticks whose measured force is within the band; None without one."""
        if self.half_width is None:
            return None
        return float(np.mean(np.abs(self.error) <= self.half_width[self.series.scored]))


def evaluate(model: Model, series: Sequence[Series], role: str) -> list[Evaluation]:
    """Return the evaluation of `model` on each series; raises RecordingError for a series without a force."""
    for one in series:
        require_force(one)
    runs = [simulate_series(model, one) for one in series]
    return [
        Evaluation(s.name, role, s, r, series_cost(s, r.force), _half_width(model, s, r), outside_ranges(model, s))
        for s, r in zip(series, runs, strict=True)
    ]


def _half_width(model: Model, series: Series, run: FreeRun) -> F | None:
    return None if model.band is None else band_half_width(model.band, series, run.force)
