"""Frequency bands: series split into bands without loss of energy, and the noise in each band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from ces_gap.baseline.noise import NoiseModel
from ces_gap.trace import F
from ces_gap.where.axes import I

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


def estimate_noise_variance(whole: Spectra, rest: Spectra, noise_energy: float) -> F:
    """Return the noise's variance (m,) [N² per line] in each band from the unpredictable part `rest`.

    This part may contain more than noise. Its density is therefore limited to a level at which the noise sums to
    `noise_energy` [N²] (reverse water-filling: Cover and Thomas, Elements of Information Theory, 2nd ed., section
    10.3.3).
    """
    count = np.maximum(whole.sums(np.ones_like(whole.line)), 1.0)
    density = np.minimum(whole.sums(whole.line**2), rest.sums(rest.line**2)) / count
    order = np.argsort(density)
    below = np.concatenate([[0.0], np.cumsum((density * count)[order])[:-1]])
    above = np.cumsum(count[order][::-1])[::-1]
    level = (noise_energy - below) / above
    reached = np.flatnonzero(level <= density[order])
    return np.minimum(density, level[reached[0]]) if len(reached) else density
