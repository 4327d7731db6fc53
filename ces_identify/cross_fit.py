"""Identification with honest errors on its own recordings: models fitted again without each part of the data.

A model is closer to the recordings that it was fitted to than to others. The error that it makes on recordings like
these is that of models that have not seen them: recordings are left out in turn, or stretches of a single one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_data.arrays import F, Mask
from ces_data.recording import Recording
from ces_identify.identification import IdentificationResult, identify
from ces_identify.polynomial.search_limits import Listener
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_observer.model import Model, Sampling

MAX_PARTS = 4  # recordings left out in turn, or groups of them
STRETCHES = 3  # of a single recording, left out in turn


@dataclass(frozen=True)
class LeftOutPart:
    """A part of a recording, by its index and from `start_s` up to `stop_s` after its first position sample.

    `model` was fitted without it.
    """

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
    """Identify a model on the whole of all recordings, then fit its parameters again without each part in turn.

    A part whose refit fails is missing from the result. Raises CesError if the data hold too little.
    """
    kept: list[tuple[Fitted, Sequence[Series]]] = []

    def keep(series: Sequence[Series], sampling: Sampling, how: IdentifyOptions, listen: Listener) -> Fitted:
        kept.append((fitter(series, sampling, how, listen), series))
        return kept[-1][0]

    result = identify(recordings, (), replace(options, split=1.0), listener, keep)
    fitted, series = kept[-1]
    groups = [found for masks in _divide(series) if (found := _leave_out(fitted, series, masks))]
    parts, models = (part for group in groups for part in group), (group[0].model for group in groups)
    return CrossFit(result, tuple(parts), tuple(models))


def _divide(series: Sequence[Series]) -> list[list[Mask]]:
    """Return one mask for each series for every part: groups of recordings, or stretches of a single one."""
    if len(series) == 1:
        ticks = np.arange(len(series[0]))
        return [[STRETCHES * ticks // len(ticks) == k] for k in range(STRETCHES)]
    groups = min(len(series), MAX_PARTS)
    return [[np.full(len(s), i % groups == k) for i, s in enumerate(series)] for k in range(groups)]


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
