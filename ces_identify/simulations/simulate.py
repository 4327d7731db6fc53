"""A model over whole arrays: a recording or a prepared series in; the force, and the half-width of its band, out.

The forces are those of the estimator; the band is the batch form of `ces_observer.band.BandRun`, with the same
half-width at every tick up to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ces_data.arrays import F, I, Mask
from ces_data.recording import Recording
from ces_identify.numerics.speed_kernels import STATUS_OK, STATUS_RESTART
from ces_identify.prepare.series import FreeRun, Series, prepare, select_samples, track_samples
from ces_identify.structures import run_batch
from ces_observer.band import STATE, Band
from ces_observer.model import Model
from ces_observer.structures.structure import Range


def simulate_series(model: Model, series: Series) -> FreeRun:
    """Return the free run of `model` on a prepared series."""
    inputs = np.stack([series.position, series.speed, series.current])
    force, held = run_batch(model, inputs, series.segments)
    return FreeRun(force, outside_envelope(model, series), held, model.force_envelope_N)


def outside_envelope(model: Model, series: Series) -> Mask:
    """Return where (ticks,) an input of `series` is outside the model's envelope."""
    ranges = model.envelope.by_signal.items()
    outside = [(x < low) | (x > high) for name, (low, high) in ranges for x in (getattr(series, name),)]
    return np.asarray(np.any(outside, axis=0))


@dataclass(frozen=True)
class SampleRun:
    """The free run of a model at the position samples of a recording, as the estimator returns it.

    `force` (n,) [N] is NaN where the estimator withholds it: at unusable samples, in the warm-up, and from a force that
    is not finite to the segment's end (where the estimator would restart its warm-up). `newest` (n,) is the newest tick
    of `series` at each sample, -1 without one; `run` is the free run on the ticks.
    """

    model: Model
    force: F
    newest: I
    series: Series
    run: FreeRun

    def held_at(self, samples: Mask) -> tuple[Range, F, Mask]:
        """Return the force envelope [N], and for some samples their time [s] and where the force was held at it."""
        ticks = self.newest[samples]
        return self.model.force_envelope_N, self.series.time_s[ticks], self.run.held[ticks]


def sample_force(model: Model, recording: Recording) -> F:
    """Return the force [N] at every position sample (n,), as the estimator returns it, NaN where it withholds it."""
    return sample_run(model, recording).force


def sample_run(model: Model, recording: Recording) -> SampleRun:
    """Return the free run of `model` at the position samples of `recording`."""
    series = prepare(recording, model.sampling)
    run = simulate_series(model, series)
    force = run.force
    samples = select_samples(recording, model.sampling)
    tracked = track_samples(samples, model.sampling)
    newest = tracked.total - 1
    slope = force[newest] - force[np.maximum(newest - 1, 0)]
    at_samples = np.clip(force[newest] + slope * tracked.ahead, *model.force_envelope_N)
    taken = (tracked.status == STATUS_OK) | (tracked.status == STATUS_RESTART)
    taken &= np.isfinite(tracked.late[newest, 1])
    starts = series.segments[:, 0]
    since = newest - starts[np.searchsorted(starts, newest, side="right") - 1]
    at_samples[~taken | (since < series.warm_up)] = np.nan
    out, ticks = np.full(len(recording.channel("position")), np.nan), np.full(len(recording.channel("position")), -1)
    out[samples.index], ticks[samples.index] = at_samples, newest
    return SampleRun(model, out, ticks, series, run)


@dataclass(frozen=True)
class BandSignals:
    """What the band depends on, tick by tick: the state (5, ticks), and rows (ticks,) of the other signals."""

    state: F
    force: F
    change_of_force: F
    reversal: F

    def at(self, ticks: Mask) -> BandSignals:
        """Return the signals at some ticks."""
        return BandSignals(self.state[:, ticks], self.force[ticks], self.change_of_force[ticks], self.reversal[ticks])


def band_half_width(band: Band, series: Series, force: F) -> F:
    """Return the half-width [N] of `band` around the free run `force` (ticks,) of `series`, NaN where that is NaN."""
    signals = band_signals(series, force, band.change_s, band.reversal_s)
    width = np.asarray(band.parts) @ part_values(signals, band.speed_m_s, band.current_A)
    return np.asarray(width * growth(band, signals.state))


def band_signals(series: Series, force: F, change_s: float, reversal_s: float) -> BandSignals:
    """Return the signals of the band for the free run `force` (ticks,) of `series`."""
    change = _change(force, series, change_s)
    return BandSignals(band_state(series, change_s), force, change, np.exp(-since_reversal(series) / reversal_s))


def band_state(series: Series, change_s: float) -> F:
    """Return the state (5, ticks) of `ces_observer.band.STATE`."""
    changes = [_change(signal, series, change_s) for signal in (series.speed, series.current)]
    return np.stack([series.position, series.speed, series.current, *changes])


def part_values(signals: BandSignals, speed_m_s: float, current_A: Range) -> F:
    """Return what the weights of `ces_observer.band.PARTS` multiply, (parts, ticks)."""
    speed, current = signals.state[STATE.index("speed")], signals.state[STATE.index("current")]
    low, high = current_A
    share = np.clip((current - low) / (high - low), 0.0, 1.0) if high > low else np.zeros(len(current))
    u = np.abs(speed) / speed_m_s
    forces = (np.abs(signals.force), np.abs(signals.change_of_force))
    return np.stack([1.0 - share, share, 1.0 / (1.0 + u), u, *forces, signals.reversal])


def growth(band: Band, state: F) -> F:
    """Return how much larger errors are at `state` (5, ticks) than on the identification data, by the band's law."""
    whitening = np.zeros((len(band.whitening), len(band.whitening)))  # its upper triangle is given by rows
    whitening[np.triu_indices(len(whitening))] = np.concatenate([np.asarray(row) for row in band.whitening])
    squares = ((whitening @ (state - np.array(band.mean)[:, None])) ** 2).sum(axis=0)
    share = band.constant_share
    return np.asarray(np.sqrt(share + (1.0 - share) * np.minimum(squares, band.max_distance**2)))


def _change(signal: F, series: Series, change_s: float) -> F:
    """Return `signal` minus its low-pass, which begins at each segment's first value."""
    decay, out = np.exp(-1.0 / (change_s * series.rate_Hz)), np.empty(len(signal))
    for start, stop in series.segments:
        first = [decay * signal[start]]
        out[start:stop] = signal[start:stop] - lfilter([1.0 - decay], [1.0, -decay], signal[start:stop], zi=first)[0]
    return out


def since_reversal(series: Series) -> F:
    """Return the time [s] (ticks,) since the last change of direction or segment start."""
    ticks = np.arange(len(series))
    turned = np.append(True, series.speed[1:] * series.speed[:-1] <= 0.0)
    turned[series.segments[:, 0]] = True
    return np.asarray((ticks - np.maximum.accumulate(np.where(turned, ticks, 0))) / series.rate_Hz)
