"""What the refits are fitted to: the measured force less the baseline's correction, on the model's own ticks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Correction
from ces_gap.errors import GapError
from ces_gap.trace import F, Trace
from ces_identify.physical.models import Body, PhysicalModels
from ces_identify.physical.reopened_models import reopen
from ces_identify.preparation.series import prepare
from ces_identify.trained.training import Training
from ces_observer.model import Model

BLOCK_S = 0.5  # [s] errors within a block count as one sample in standard errors
MAX_TICKS = 40_000  # of the fitted recordings: the first part of each


@dataclass(frozen=True)
class RefitTarget:
    """Models on the nodes of a baseline, its parameters `theta`, weights (ticks,) and blocks (ticks,) of the data."""

    models: PhysicalModels
    theta: F
    weights: F
    blocks: NDArray[np.int64]

    def square_errors(self, theta: F) -> F:
        """Return the sum of the squared errors [N2] in each block (b,)."""
        error = np.where(self.weights > 0.0, self.models.force(theta) - self.models.training.measured, 0.0)
        return np.asarray(np.bincount(self.blocks, error**2), np.float64)

    @property
    def count(self) -> int:
        """The number of ticks that count."""
        return int((self.weights > 0.0).sum())


def build_target(
    model: Model, body: Body, traces: Sequence[Trace], correction: Correction | None
) -> RefitTarget | None:
    """Return the target on the usable ticks of the traces; None if the model was not made by these models.

    Raises GapError without usable ticks.
    """
    series = [prepare(trace.recording, model.sampling) for trace in traces]
    share = min(1.0, MAX_TICKS / max(1, sum(len(one) for one in series)))
    series = [one.part(0.0, share) for one in series]
    keep, measured = [], []
    for one, trace in zip(series, traces, strict=True):
        usable = np.interp(one.time_s, trace.time_s, trace.usable) > 0.99
        keep.append(one.scored & usable)
        added = 0.0 if correction is None else correction.force(trace, trace.inputs, trace.simulated)
        measured.append(one.force - np.interp(one.time_s, trace.time_s, np.zeros(len(trace)) + added))
    mask, force = np.concatenate(keep), np.concatenate(measured)
    if not mask.any():
        raise GapError(f"{', '.join(t.name for t in traces)}: no usable tick after the model's warm-up")
    inputs = np.stack([np.concatenate([getattr(s, n) for s in series]) for n in ("position", "speed", "current")])
    starts = np.cumsum([0, *(len(s) for s in series[:-1])])
    segments = np.concatenate([s.segments + at for s, at in zip(series, starts, strict=True)])
    owners = np.repeat(np.arange(len(series)), [len(s.segments) for s in series])
    spread = float(force[mask].std())
    weights: F = np.where(mask, 1.0 / (mask.sum() * spread**2), 0.0)
    training = Training(
        inputs=inputs,
        measured=np.where(mask, force, 0.0),
        segments=np.ascontiguousarray(segments, np.int64),
        recordings=owners,
        estimation=weights,
        selection=np.zeros_like(weights),
        envelope=model.envelope,
        force_envelope=model.force_envelope_N,
        scale_N=spread,
    )
    opened = reopen(body, 1.0 / model.sampling.rate_Hz, training)
    if opened is None:
        return None
    return RefitTarget(*opened, weights, _number_blocks([s.time_s for s in series]))


def _number_blocks(times: Sequence[F]) -> NDArray[np.int64]:
    """Return the number of each tick's block, through all series."""
    first, numbers = 0, []
    for time_s in times:
        numbers.append(first + (time_s / BLOCK_S).astype(np.int64))
        first = int(numbers[-1][-1]) + 1
    return np.concatenate(numbers)
