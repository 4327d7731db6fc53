"""The band of a model over whole arrays: a prepared series and its free run in, half-widths out.

This is the batch form of `ces_observer.band.BandRun`, with the same half-width at every tick up to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ces_identify.numerics.arrays import F, Mask
from ces_identify.preparation.series import Series
from ces_observer.band import STATE, Band
from ces_observer.structures.structure import Range


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
    squares = ((as_matrix(band.whitening) @ (state - np.array(band.mean)[:, None])) ** 2).sum(axis=0)
    share = band.constant_share
    return np.asarray(np.sqrt(share + (1.0 - share) * np.minimum(squares, band.max_distance**2)))


def as_matrix(triangle: Sequence[Sequence[float]]) -> F:
    """Return an upper triangle, given by its rows from the diagonal on, as a matrix."""
    matrix = np.zeros((len(triangle), len(triangle)))
    matrix[np.triu_indices(len(triangle))] = np.concatenate([np.asarray(row) for row in triangle])
    return matrix


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
