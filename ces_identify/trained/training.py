"""The data of a simulation-error fit: stacked series with weights for estimation and for selection.

Estimation and selection are the alternating blocks of `ces_identify.polynomial.problem`; every recording has the same
weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I
from ces_identify.polynomial.problem import assemble_problem
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.prepare.series import Series
from ces_observer.errors import CesError
from ces_observer.model import Envelope
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.structure import Range
from ces_observer.structures.terms import Term

SIGNALS = ("position", "speed", "current")
ROUND_ZERO = 0.25  # share of the force envelope's range by which it extends beyond 0, where every run starts
LOOSE = 1e3  # limit of the force in a descent, in standard deviations
MIN_CHANGE = 1e-3  # relative range below which an input counts as constant and makes no regressor


@dataclass(frozen=True)
class Lags:
    """Which regressors to use: lags of past forces [ticks], and delays of the inputs [s], rounded to ticks."""

    force: tuple[int, ...] = (1,)
    speed_s: tuple[float, ...] = (0.0, 0.003)
    current_s: tuple[float, ...] = (0.008,)
    position_s: tuple[float, ...] = ()


LAGS = Lags()


@dataclass(frozen=True)
class LagCounts:
    """How many past forces (from one tick ago), currents and speeds (from this tick on) to use: thesis table 5.2."""

    forces: int
    currents: int
    speeds: int

    def at_rate(self, rate_Hz: float) -> Lags:
        """Return the lags at a model's rate; a tick is a tick at every rate."""
        currents, speeds = (tuple(k / rate_Hz for k in range(count)) for count in (self.currents, self.speeds))
        return Lags(tuple(range(1, self.forces + 1)), speeds, currents)


@dataclass(frozen=True)
class Training:
    """Stacked series: `inputs` (3, ticks) position [m], speed [m/s] and current [A], `measured` force (ticks,) [N].

    `estimation` and `selection` (ticks,) weight squared errors so that those of a recording sum to (J / 100)^2; no tick
    has both. `recordings` is each segment's recording. `scale_N` is the standard deviation of the measured force.
    """

    inputs: F
    measured: F
    segments: I
    recordings: I
    estimation: F
    selection: F
    envelope: Envelope
    force_envelope: Range
    scale_N: float

    @property
    def loose(self) -> Range:
        """Bounds [N] of the force during a descent, which may leave the force envelope for a while."""
        return -LOOSE * self.scale_N, LOOSE * self.scale_N

    @property
    def level(self) -> float:
        """Mean measured force on the estimation ticks, in standard deviations."""
        return float(self.estimation @ self.measured / self.estimation.sum()) / self.scale_N

    def cost(self, force: F, weights: F) -> float:
        """Return the mean J [%] of `force` (ticks,) over the recordings; infinite if a force is not finite."""
        if not np.isfinite(force).all():
            return float("inf")
        errors = weights * (force - self.measured) ** 2
        shares = np.zeros(self.recordings.max() + 1)
        for (start, stop), recording in zip(self.segments, self.recordings, strict=True):
            shares[recording] += errors[start:stop].sum()
        return float(100.0 * np.sqrt(shares).mean())

    def regressor(self, signal: str, lag: int) -> Regressor:
        """Return a regressor scaled by mean and standard deviation; a past force by the latter alone."""
        if signal == "force":
            return Regressor(signal, lag, 0.0, self.scale_N)
        values = self.inputs[SIGNALS.index(signal)]
        spread = float(values.std())
        return Regressor(signal, lag, float(values.mean()), spread if spread > 1e-9 else 1.0)

    def changing_inputs(self) -> set[str]:
        """Return the names of the inputs that are not constant."""
        ranges = {name: (np.ptp(row), np.abs(row).max()) for name, row in zip(SIGNALS, self.inputs, strict=True)}
        return {name for name, (span, size) in ranges.items() if span > MIN_CHANGE * max(1e-9, size)}


def build_regressors(data: Training, lags: Lags | LagCounts, rate_Hz: float) -> tuple[Regressor, ...]:
    """Return the scaled regressors, without those of constant inputs; raises CesError if none is left."""
    lags = lags.at_rate(rate_Hz) if isinstance(lags, LagCounts) else lags
    delays = {"speed": lags.speed_s, "current": lags.current_s, "position": lags.position_s}
    chosen = [("force", lag) for lag in lags.force]
    for signal, seconds in delays.items():
        if signal in data.changing_inputs():
            chosen += [(signal, lag) for lag in dict.fromkeys(round(s * rate_Hz) for s in seconds)]
    if not chosen:
        raise CesError("every input among the regressors is constant; use past forces or another input, too")
    return tuple(data.regressor(signal, lag) for signal, lag in chosen)


def build_training(series: Sequence[Series], weighting: Weighting = EQUAL) -> Training:
    """Return the data to fit to; raises RecordingError if there is too little."""
    problem = assemble_problem(series, (Term(1.0, ()),), weighting=weighting)
    scored = problem.everything > 0.0
    low, high = problem.force_envelope
    reach = ROUND_ZERO * (high - low)
    return Training(
        inputs=np.stack([np.concatenate([getattr(s, name) for s in series]) for name in SIGNALS]),
        measured=problem.measured,
        segments=problem.segments,
        recordings=problem.recordings,
        estimation=np.where(problem.selection > 0.0, 0.0, problem.everything),
        selection=problem.selection,
        envelope=problem.envelope,
        force_envelope=(min(low, -reach), max(high, reach)),
        scale_N=float(problem.measured[scored].std()),
    )
