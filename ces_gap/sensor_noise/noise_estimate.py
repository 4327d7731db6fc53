"""Records of the noise of a measured force: what each source says, and the value that is used."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
B = NDArray[np.bool_]

CYCLES = "repeated cycles"
STANDSTILL = "standstill"
HIGH_FREQUENCIES = "high frequencies"
QUANTUM = "sensor quantum"
NO_SOURCE = "no source"


@dataclass(frozen=True)
class GridSignals:
    """What was measured, on the grid of a trace: arrays (n,) of position [m], speed, acceleration, current, force."""

    rate_Hz: float
    position: F
    speed: F
    acceleration: F
    current: F
    force: F
    usable: B


@dataclass(frozen=True)
class NoiseEstimate:
    """What one source says about the noise on the grid, `rms_N` [N]; `problem` says why it is not valid, if it is not.

    `lag1` is the autocorrelation of the noise from tick to tick, NaN if the source does not show it.
    """

    source: str
    rms_N: float
    problem: str = ""
    lag1: float = math.nan

    @property
    def valid(self) -> bool:
        """Whether the noise is at most `rms_N` according to this source."""
        return not self.problem


@dataclass(frozen=True)
class MeasuredNoise:
    """The noise of the measured force on the grid, RMS [N], its `source`, and what the `others` say.

    It is `known` if at least one source limits it from above; otherwise `rms_N` is only the best guess.
    `quantum_N` [N] is the step of the logged values, 0 if none is found. `lag1` is the autocorrelation from tick to
    tick (NaN if unknown), `white_lag1` that of white noise on the same grid.
    """

    rms_N: float
    source: str
    others: tuple[NoiseEstimate, ...] = ()
    known: bool = False
    quantum_N: float = 0.0
    lag1: float = math.nan
    white_lag1: float = 0.0

    @property
    def range_N(self) -> tuple[float, float]:
        """The smallest and the largest value [N] of the valid sources: how far they agree."""
        values = [self.rms_N, *(e.rms_N for e in self.others if e.valid)]
        return min(values), max(values)

    def describe_source(self) -> str:
        """Return the source in a few words, as in `8.1 N from repeated cycles`."""
        return self.source if self.known else f"{self.source}, not limited by any source"


UNMEASURED = MeasuredNoise(0.0, NO_SOURCE)
