"""Batch runs of physical models: a structure and inputs in, force out, as the estimator computes it tick by tick."""

from __future__ import annotations

from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.physical.chambers_kernels import run_chambers
from ces_identify.physical.chambers_models import chamber_arrays
from ces_identify.physical.models import NO_FIT, Kernel
from ces_identify.physical.relaxation_kernels import run_relaxation
from ces_identify.physical.relaxation_models import relaxation_arrays
from ces_identify.physical.valve_kernels import RunData, Score
from ces_observer.model import Model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.reach import widen
from ces_observer.structures.relaxation import Relaxation


def run_relaxation_model(body: Relaxation, model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return the batch run, as `StructureKit.batch_run` describes it."""
    return _run(
        run_relaxation, relaxation_arrays(body, 1.0 / model.sampling.rate_Hz), body.reach, model, inputs, segments
    )


def run_chambers_model(body: Chambers, model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return the batch run, as `StructureKit.batch_run` describes it."""
    return _run(run_chambers, chamber_arrays(body, 1.0 / model.sampling.rate_Hz), body.reach, model, inputs, segments)


def _run(kernel: Kernel, arrays: Any, reach: float, model: Model, inputs: F, segments: I) -> tuple[F, int]:
    ranges = widen(model.envelope.by_signal, reach)
    names = ("position", "speed", "current")
    limited = [np.ascontiguousarray(np.clip(row, *ranges[name])) for row, name in zip(inputs, names, strict=True)]
    ticks = inputs.shape[1]
    force = np.full(ticks, np.nan)
    nothing = Score(np.zeros(ticks), np.zeros(ticks), np.zeros(ticks, np.int64), 1)
    data = RunData(limited[0], limited[1], limited[2], np.asarray(segments, np.int64))
    kernel(arrays, data, nothing, force, NO_FIT, NO_FIT)
    low, high = model.force_envelope_N
    first = -1
    for start, stop in segments:
        outside = np.flatnonzero(~((force[start:stop] >= low) & (force[start:stop] <= high)))
        if len(outside):
            force[start + outside[0] : stop] = np.nan
            first = start + int(outside[0]) if first < 0 else first
    return force, first
