"""The energy of a gap at every tick and in every frequency band, without measurement noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from ces_data.arrays import F, I
from ces_gap.baseline.learner import NoiseModel
from ces_gap.errors import GapError
from ces_gap.trace import Trace, require_usable

OCTAVES_HZ = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
MIN_LINES = 8  # spectral lines of the shortest recording in a band


@dataclass(frozen=True)
class Spectra:
    """Cosine transforms of several series, concatenated: `line` (n,), with the `frequency` [Hz] and `band` of each."""

    line: F
    frequency: F
    band: I
    count: int

    def sums(self, weight: F) -> F:
        """Return the sums (m,) of a weight (n,) over the lines of each band."""
        return np.bincount(self.band, weight, minlength=self.count).astype(np.float64)


def spectra_of(series: Sequence[F], rates_Hz: Sequence[float], edges_Hz: F) -> Spectra:
    """Return the orthogonal cosine transforms of series (n,) and the band of each of their lines."""
    frequency = np.concatenate([np.arange(len(y)) * (r / 2.0 / len(y)) for y, r in zip(series, rates_Hz, strict=True)])
    band = np.clip(np.searchsorted(edges_Hz, frequency, side="right") - 1, 0, len(edges_Hz) - 2)
    line = np.concatenate([np.asarray(dct(y, norm="ortho")) for y in series])
    return Spectra(line, frequency, np.asarray(band, dtype=np.int64), len(edges_Hz) - 1)


def octaves(series: Sequence[F], rates_Hz: Sequence[float]) -> F:
    """Return the edges [Hz] of octave bands, none narrower than the shortest recording resolves."""
    top = max(rates_Hz) / 2.0
    line = max(r / (2.0 * len(y)) for y, r in zip(series, rates_Hz, strict=True))
    return np.array([0.0, *(f for f in OCTAVES_HZ if MIN_LINES * line <= f < 0.75 * top), top])


def split_into_bands(values: F, rate_Hz: float, edges_Hz: F) -> F:
    """Return the parts (n, m) of a series (n,) in bands that cover all frequencies; their energies add up.

    The orthogonal cosine transform continues a series by its mirror image, without a step at its ends.
    """
    spectra = spectra_of([values], [rate_Hz], edges_Hz)
    masked = spectra.line[:, None] * (spectra.band[:, None] == np.arange(spectra.count))
    return np.asarray(idct(masked, axis=0, norm="ortho"))


def ar_spectrum(noise: NoiseModel, frequency_Hz: F, rate_Hz: float) -> F:
    """Return the spectrum (n,) of autoregressive noise with unit variance of the innovations."""
    lag = np.exp(-2j * np.pi * frequency_Hz[:, None] / rate_Hz * np.arange(1, len(noise.ar) + 1))
    return np.asarray(np.abs(1.0 - lag @ noise.ar) ** -2.0)


@dataclass(frozen=True)
class Energy:
    """The energy of a gap [N²] on the usable ticks of all recordings, concatenated; means may be negative.

    `tick` (n,) and `band` (n, m), between `edges_Hz` (m+1,), have the same sum. For each band, `noise_error` (m,) is
    the standard error of its mean energy due to noise alone, `lines` (m,) the number of its spectral lines, and `force`
    (m,) its share of the measured force's energy.
    """

    step_s: F
    tick: F
    band: F
    edges_Hz: F
    noise_error: F
    lines: F
    force: F


def gap_energy(traces: Sequence[Trace], gap: Sequence[F], noise: NoiseModel, edges_Hz: F | None = None) -> Energy:
    """Return the energy of gaps [N] (n,) on the grids of traces, in bands between `edges_Hz` (octaves by default).

    Raises GapError if a gap is not finite at usable ticks.
    """
    series, rates = [_usable(t, g) for t, g in zip(traces, gap, strict=True)], [t.rate_Hz for t in traces]
    edges = octaves(series, rates) if edges_Hz is None else edges_Hz
    spectra, lengths = spectra_of(series, rates, edges), [len(y) for y in series]
    variance, shape = noise.rms_N * noise.rms_N, ar_spectrum(noise, spectra.frequency, rates[0])
    mean = np.add.reduceat(shape, np.cumsum([0, *lengths[:-1]])) / np.asarray(lengths)
    floor = shape * np.repeat(variance / np.maximum(mean, 1e-300), lengths)  # of this shape, with each trace's noise
    parts = [split_into_bands(y, r, edges) ** 2 for y, r in zip(series, rates, strict=True)]
    owner = np.repeat(np.arange(len(series)), lengths)
    measured = spectra_of([t.force[t.usable] for t in traces], rates, edges)
    force = measured.sums(measured.line**2)
    floors = np.stack([spectra.sums(floor * (owner == k)) / n for k, n in enumerate(lengths)])
    return Energy(
        step_s=np.repeat([t.step_s for t in traces], lengths),
        tick=np.concatenate(series) ** 2 - variance,
        band=np.concatenate(parts) - floors[owner],
        edges_Hz=edges,
        noise_error=np.sqrt(np.maximum(spectra.sums(4.0 * floor * spectra.line**2 - 2.0 * floor**2), 0.0)) / len(owner),
        lines=spectra.sums(np.ones_like(floor)),
        force=force / max(float(force.sum()), 1e-300),
    )


def _usable(trace: Trace, gap: F) -> F:
    require_usable(trace)
    if gap.shape != trace.time_s.shape or not np.isfinite(gap[trace.usable]).all():
        raise GapError(
            f"{trace.name}: a gap of shape {gap.shape}, {int((~np.isfinite(gap)).sum())} not finite; expected "
            f"{trace.time_s.shape} and finite at usable ticks; check what the simulation returns"
        )
    return gap[trace.usable]
