"""Scaled regressors over whole series, as the kernels of networks and neuro-fuzzy models need them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.trained.lagged_kernels import RegressorTable
from ces_observer.model import Envelope
from ces_observer.structures.lagged_signals import COLUMNS, Regressor


def regressor_table(regressors: Sequence[Regressor], envelope: Envelope, inputs: F, segments: I) -> RegressorTable:
    """Return the regressors of `inputs` (3, ticks), clamped; before a segment they have its first values."""
    values = np.zeros((inputs.shape[1], len(regressors)))
    for j, r in enumerate(regressors):
        if r.signal != "force":
            clamped = np.clip(inputs[COLUMNS[r.signal]], *envelope.by_signal[r.signal])
            values[:, j] = (delay_values(clamped, r.lag, segments) - r.mean) / r.spread
    past = [r if r.signal == "force" else Regressor("force", 0, 0.0, 1.0) for r in regressors]
    return RegressorTable(
        values,
        np.array([r.lag for r in past], np.int64),
        np.array([r.mean for r in past]),
        np.array([r.spread for r in past]),
    )


def unscaled_inputs(lags: Iterable[tuple[str, int]], envelope: Envelope, inputs: F, segments: I) -> F:
    """Return inputs (ticks, n) at lags [ticks] in SI units; `lags` holds names and lags."""
    raw = [Regressor(signal, lag, 0.0, 1.0) for signal, lag in lags]
    return regressor_table(raw, envelope, inputs, segments).values


def delay_values(values: F, lag: int, segments: I) -> F:
    """Return `values` (ticks,) `lag` ticks ago, within each segment."""
    index = np.arange(len(values)) - lag
    for start, stop in segments:
        index[start:stop] = np.maximum(index[start:stop], start)
    return values[np.maximum(index, 0)]
