"""Free-run simulation of a model in batch: prepared series in, force out.

This is the fast version of `ces_observer.estimator`, with the same force at every tick up to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics import kernels
from ces_identify.numerics.arrays import F, I, Mask
from ces_identify.preparation.series import Series, prepare, select_samples, track_samples
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.band_run import band_half_width
from ces_identify.structures import run_batch
from ces_observer.errors import ModelError
from ces_observer.model import Model


@dataclass(frozen=True)
class FreeRun:
    """Simulated force [N] of shape (ticks,), NaN from where it left the force envelope.

    `clamped` marks the ticks with inputs outside the envelope; `diverged` is the first tick out of bounds, -1 if none.
    """

    force: F
    clamped: Mask
    diverged: int


def simulate_series(model: Model, series: Series) -> FreeRun:
    """Return the free run of `model` on a prepared series."""
    inputs = np.stack([series.position, series.speed, series.current])
    force, diverged = run_batch(model, inputs, series.segments)
    return FreeRun(force, outside_envelope(model, series), diverged)


def outside_envelope(model: Model, series: Series) -> Mask:
    """Return where (ticks,) an input of `series` is outside the model's envelope."""
    ranges = model.envelope.by_signal.items()
    outside = [(x < low) | (x > high) for name, (low, high) in ranges for x in (getattr(series, name),)]
    return np.asarray(np.any(outside, axis=0))


@dataclass(frozen=True)
class SampleRun:
    """The free run of a model at the position samples of a recording, as the estimator returns it.

    `force` (n,) [N] is NaN where the estimator withholds it: at unusable samples, in the warm-up, and from a divergence
    to the segment's end (where the estimator would restart its warm-up). `newest` (n,) is the newest tick of `series`
    at each sample, -1 without one; `run` is the free run on the ticks.
    """

    force: F
    newest: I
    series: Series
    run: FreeRun


def sample_force(model: Model, recording: Recording) -> F:
    """Return the force [N] at every position sample (n,), as the estimator returns it, NaN where it withholds it."""
    return sample_run(model, recording).force


def sample_bounds(model: Model, recording: Recording) -> tuple[F, F]:
    """Return the lower and upper bound [N] of the band at every position sample (n,), NaN where there is no force.

    Raises ModelError if the model has no band.
    """
    if model.band is None:
        raise ModelError("the model has no band; identify it again without --no-band")
    at = sample_run(model, recording)
    widths = np.append(band_half_width(model.band, at.series, at.run.force), np.nan)[at.newest]
    return at.force - widths, at.force + widths


def sample_run(model: Model, recording: Recording) -> SampleRun:
    """Return the free run of `model` at the position samples of `recording`."""
    series = prepare(recording, model.sampling)
    run = simulate_series(model, series)
    force = run.force
    samples = select_samples(recording, model.sampling)
    *_, total, status, ahead, _ = track_samples(samples, model.sampling)
    newest = total - 1
    slope = force[newest] - force[np.maximum(newest - 1, 0)]
    at_samples = np.clip(force[newest] + slope * ahead, *model.force_envelope_N)
    taken = (status == kernels.STATUS_OK) | (status == kernels.STATUS_RESTART)
    starts = series.segments[:, 0]
    since = newest - starts[np.searchsorted(starts, newest, side="right") - 1]
    at_samples[~taken | (since < series.warm_up)] = np.nan
    out, ticks = np.full(len(recording.channel("position")), np.nan), np.full(len(recording.channel("position")), -1)
    out[samples.index], ticks[samples.index] = at_samples, newest
    return SampleRun(out, ticks, series, run)
