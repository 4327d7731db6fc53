"""Models that have not seen part of the data: cross-validation over recordings, and models fitted again without a part.

Cross-validation holds each fold out once and evaluates a model identified on the others on it. A single recording is
cut into as many stretches as folds; the parts before and after a held-out stretch become two recordings, so that no
model runs across the cut.

A model is closer to the recordings that it was fitted to than to others. The error that it makes on recordings like
these is that of models that have not seen them: `cross_fit` identifies one model on all recordings, and fits it again
without each recording, or without stretches of a single one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from ces_data.arrays import F, Mask
from ces_data.recording import Recording
from ces_identify.identification import IdentificationResult, identify
from ces_identify.numerics.search import Listener
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.validation.evaluate import VALIDATION, CostInterval, cost_interval
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling

Identifier = Callable[[Sequence[Recording], Sequence[Recording], IdentifyOptions], IdentificationResult]
MIN_STRETCH_S = 2.0


@dataclass(frozen=True)
class Fold:
    """Recordings for identification, and those held out."""

    identification: tuple[Recording, ...]
    held_out: tuple[Recording, ...]


@dataclass(frozen=True)
class HeldOutCost:
    """A held-out recording: its fold, the cost J [%] and its interval, and the size of the model."""

    fold: int
    recording: str
    cost: float
    interval: CostInterval | None
    model: str


@dataclass(frozen=True)
class CrossValidation:
    """The held-out costs of all recordings."""

    rows: tuple[HeldOutCost, ...]

    @property
    def mean(self) -> float:
        """Mean J [%] over the recordings; infinite if a free run diverged."""
        return float(np.mean([row.cost for row in self.rows]))

    @property
    def spread(self) -> float:
        """Standard deviation (n - 1) of J [%]; infinite after a divergence. No error of the mean: folds share data."""
        costs = [row.cost for row in self.rows]
        return float(np.std(costs, ddof=1)) if np.isfinite(costs).all() else float("inf")


def cross_validate(
    recordings: Sequence[Recording], folds: int, identify: Identifier, options: IdentifyOptions
) -> CrossValidation:
    """Return the held-out costs of `folds` identifications; raises CesError, also for too few recordings."""
    options, rows = replace(options, split=1.0), []
    for number, fold in enumerate(split_folds(recordings, folds), 1):
        result = identify(fold.identification, fold.held_out, options)
        tests = (e for e in result.evaluations if e.role == VALIDATION)
        rows += [HeldOutCost(number, e.name, e.cost, cost_interval([e]), result.model.size) for e in tests]
    return CrossValidation(tuple(rows))


def split_folds(recordings: Sequence[Recording], folds: int) -> list[Fold]:
    """Return the folds: recordings in turn, or stretches of a single one. Raises CesError if there are too few."""
    if folds < 2:
        raise CesError(f"--folds {folds}: expected at least 2")
    if len(recordings) == 1:
        return list(_cut_into_folds(recordings[0], folds))
    if folds > len(recordings):
        raise CesError(
            f"--folds {folds}: {len(recordings)} recordings; expected at most as many folds (or a single recording, "
            "which is cut into stretches)"
        )
    numbered = list(enumerate(recordings))
    return [
        Fold(tuple(r for i, r in numbered if i % folds != k), tuple(r for i, r in numbered if i % folds == k))
        for k in range(folds)
    ]


def cut_recording(recording: Recording, start_ns: int, stop_ns: int) -> Recording:
    """Return the samples with stamps from `start_ns` up to `stop_ns` as a recording."""
    channels = {
        name: channel.select((channel.stamps_ns >= start_ns) & (channel.stamps_ns < stop_ns))
        for name, channel in recording.channels.items()
    }
    origin = int(recording.channel("position").stamps_ns.min())
    name = f"{recording.name} {(start_ns - origin) * 1e-9:.1f}-{(stop_ns - origin) * 1e-9:.1f} s"
    return replace(recording, name=name, channels=channels)


def _cut_into_folds(recording: Recording, folds: int) -> Iterator[Fold]:
    stamps = recording.channel("position").stamps_ns
    edges = np.linspace(stamps.min(), stamps.max() + 1, folds + 1).round().astype(np.int64).tolist()
    if edges[1] - edges[0] < MIN_STRETCH_S * 1e9:
        raise CesError(
            f"--folds {folds}: {recording.name} gives stretches of {(edges[1] - edges[0]) * 1e-9:.2f} s; expected at "
            f"least {MIN_STRETCH_S:g} s; use fewer folds"
        )
    for a, b in pairwise(edges):
        rest = [cut_recording(recording, *span) for span in ((edges[0], a), (b, edges[-1])) if span[0] < span[1]]
        yield Fold(tuple(rest), (cut_recording(recording, a, b),))


MAX_PARTS = 4  # recordings left out in turn, or groups of them
STRETCHES = 3  # of a single recording, left out in turn


@dataclass(frozen=True)
class LeftOutPart:
    """A part of a recording (index), from `start_s` to `stop_s` after its first position sample, unseen by `model`."""

    recording: int
    start_s: float
    stop_s: float
    model: Model


@dataclass(frozen=True)
class CrossFit:
    """A model identified on all recordings, and `models` that have not seen some `parts` of them."""

    result: IdentificationResult
    parts: tuple[LeftOutPart, ...]
    models: tuple[Model, ...]


def cross_fit(
    recordings: Sequence[Recording], options: IdentifyOptions, listener: Listener, fitter: Fitter
) -> CrossFit:
    """Return a model of all recordings, and its refits without each part in turn (none failed); raises CesError."""
    kept: list[tuple[Fitted, Sequence[Series]]] = []

    def keep(series: Sequence[Series], sampling: Sampling, how: IdentifyOptions, listen: Listener) -> Fitted:
        kept.append((fitter(series, sampling, how, listen), series))
        return kept[-1][0]

    result = identify(recordings, (), replace(options, split=1.0), listener, keep)
    fitted, series = kept[-1]
    if len(series) == 1:
        count, groups = STRETCHES, [STRETCHES * np.arange(len(series[0])) // len(series[0])]
    else:
        count = min(len(series), MAX_PARTS)
        groups = [np.full(len(one), i % count) for i, one in enumerate(series)]
    masks = [[group == k for group in groups] for k in range(count)]
    with ThreadPoolExecutor(max(1, options.limits.threads)) as pool:
        found = list(pool.map(partial(_leave_out, fitted, series), masks))
    parts = tuple(part for group in found for part in group)
    return CrossFit(result, parts, tuple(group[0].model for group in found if group))


def _leave_out(fitted: Fitted, series: Sequence[Series], masks: Sequence[Mask]) -> list[LeftOutPart]:
    weights: F = np.where(np.concatenate(masks), 0.0, 1.0)
    model = fitted.refit(weights) if fitted.refit is not None else None
    if model is None:
        return []
    parts = []
    for i, (one, mask) in enumerate(zip(series, masks, strict=True)):
        if mask.any():  # a part reaches to infinity at the ends of its recording
            start_s = -np.inf if mask[0] else float(one.time_s[mask][0])
            stop_s = np.inf if mask[-1] else float(one.time_s[mask][-1]) + 1.0 / one.rate_Hz
            parts.append(LeftOutPart(i, start_s, stop_s, model))
    return parts
