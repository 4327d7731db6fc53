"""What a simulation-error fit works on: stacked series, and which ticks it may fit to and which it may choose by.

Estimation and selection are the alternating blocks of `ces_identify.polynomial.problem`; every recording weighs the
same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.polynomial.problem import assemble_problem
from ces_identify.preparation.series import Series
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_observer.model import Envelope
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.structure import Range
from ces_observer.structures.terms import Term

SIGNALS = ("position", "speed", "current")
ROUND_ZERO = 0.25  # of the force envelope's span, by which it must reach beyond zero, where every run begins
LOOSE = 1e3  # spreads of force that a descent may stray


@dataclass(frozen=True)
class Training:
    """Stacked series: `inputs` (3, ticks) position [m], speed [m/s] and current [A], `measured` force (ticks,) [N].

    `estimation` and `selection` (ticks,) weigh squared errors such that each recording's make up (J / 100)^2; no tick
    has both. `recordings` tells each segment's recording. `scale_N` is the spread of the measured force.
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
        """Bounds [N] on the force during a descent, where it may for a while leave the force envelope."""
        return -LOOSE * self.scale_N, LOOSE * self.scale_N

    @property
    def level(self) -> float:
        """Mean measured force on the estimation ticks, in spreads."""
        return float(self.estimation @ self.measured / self.estimation.sum()) / self.scale_N

    def cost(self, force: F, weights: F) -> float:
        """Return the mean over recordings of J [%] of `force` (ticks,); infinite if it is not finite somewhere."""
        if not np.isfinite(force).all():
            return float("inf")
        errors = weights * (force - self.measured) ** 2
        shares = np.zeros(self.recordings.max() + 1)
        for (start, stop), recording in zip(self.segments, self.recordings, strict=True):
            shares[recording] += errors[start:stop].sum()
        return float(100.0 * np.sqrt(shares).mean())

    def regressor(self, signal: str, lag: int) -> Regressor:
        """Return a regressor scaled by its mean and spread over the ticks; a past force by the force's spread alone."""
        if signal == "force":
            return Regressor(signal, lag, 0.0, self.scale_N)
        values = self.inputs[SIGNALS.index(signal)]
        spread = float(values.std())
        return Regressor(signal, lag, float(values.mean()), spread if spread > 1e-9 else 1.0)


def build_training(series: Sequence[Series], weighting: Weighting = EQUAL) -> Training:
    """Return what to fit to; raises RecordingError if the series hold too little."""
    problem = assemble_problem(series, (Term(1.0, ()),), weighting=weighting)
    scored = problem.everything > 0.0
    return Training(
        inputs=np.stack([np.concatenate([getattr(s, name) for s in series]) for name in SIGNALS]),
        measured=problem.measured,
        segments=problem.segments,
        recordings=problem.recordings,
        estimation=np.where(problem.selection > 0.0, 0.0, problem.everything),
        selection=problem.selection,
        envelope=problem.envelope,
        force_envelope=_round_zero(problem.force_envelope),
        scale_N=float(problem.measured[scored].std()),
    )


def _round_zero(force: Range) -> Range:
    reach = ROUND_ZERO * (force[1] - force[0])
    return min(force[0], -reach), max(force[1], reach)
