"""A prepared series and a model's free run on it, for every kind of run."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ces_identify.preparation.series import Series


class ForceRun(Protocol):
    """A simulated force."""

    @property
    def force(self) -> NDArray[np.float64]:
        """Simulated force [N] (ticks,), NaN where there is none."""


class SimulatedSeries(Protocol):
    """A series and a free run on it."""

    @property
    def series(self) -> Series:
        """The series."""

    @property
    def run(self) -> ForceRun:
        """The free run."""
