"""Free-run simulation of a model in batch: prepared series, or any position and current, in; force out.

These are the fast twins of `ces_observer.estimator`: tick for tick the same force to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics import kernels
from ces_identify.numerics.arrays import B, F
from ces_identify.preparation.series import Series, prepare, track_samples, usable_samples
from ces_identify.recordings.recording import Recording
from ces_identify.structures import run_batch
from ces_observer.model import Model


@dataclass(frozen=True)
class FreeRun:
    """Simulated force [N] of shape (ticks,), NaN from where it left the force envelope; `clamped` marks the ticks
    whose inputs lay outside the input envelope; `diverged` is the first tick out of bounds, -1 if none."""

    force: F
    clamped: B
    diverged: int


def simulate_series(model: Model, series: Series) -> FreeRun:
    """Return the free run of `model` over a prepared series."""
    inputs = np.stack([series.position, series.speed, series.current])
    force, diverged = run_batch(model, inputs, series.segments)
    return FreeRun(force, outside_envelope(model, series), diverged)


def outside_envelope(model: Model, series: Series) -> B:
    """Return where (ticks,) an input of `series` lies outside the model's input envelope."""
    e = model.envelope
    out = np.zeros(len(series), bool)
    for values, (low, high) in (
        (series.position, e.position_m),
        (series.speed, e.speed_m_s),
        (series.current, e.current_A),
    ):
        out |= (values < low) | (values > high)
    return out


def sample_force(model: Model, recording: Recording) -> F:
    """Return the force [N] at every position sample (n,), as the estimator gives it.

    NaN where the estimator would withhold: unusable samples, warm-up, and from a divergence to the end of the segment
    (where the estimator would warm up anew).
    """
    series = prepare(recording, model.sampling)
    force = simulate_series(model, series).force
    samples = usable_samples(recording, model.sampling.max_current_age_s)
    *_, total, status, ahead, _ = track_samples(samples, model.sampling)
    newest = total - 1
    slope = force[newest] - force[np.maximum(newest - 1, 0)]
    at_samples = np.clip(force[newest] + slope * ahead, *model.force_envelope_N)
    taken = (status == kernels.STATUS_OK) | (status == kernels.STATUS_RESTART)
    starts = series.segments[:, 0]
    since = newest - starts[np.searchsorted(starts, newest, side="right") - 1]
    at_samples[~taken | (since < series.warm_up)] = np.nan
    out = np.full(len(recording.channel("position")), np.nan)
    out[samples.index] = at_samples
    return out
