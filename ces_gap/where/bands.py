"""Frequency bands: series cut into them without losing energy, and the noise's share of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from ces_gap.baseline.noise import NoiseModel

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741

OCTAVES_HZ = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
MIN_LINES = 8  # of the shortest recording's spectrum in a band


@dataclass(frozen=True)
class Spectra:
    """The cosine transforms of some series end to end: `line` (n,), `frequency` [Hz] (n,), and `band` (n,) of each."""

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
    """Return the edges [Hz] of bands an octave wide, none narrower than the shortest recording resolves."""
    top = max(rates_Hz) / 2.0
    line = max(r / (2.0 * len(y)) for y, r in zip(series, rates_Hz, strict=True))
    return np.array([0.0, *(f for f in OCTAVES_HZ if MIN_LINES * line <= f < 0.75 * top), top])


def split_into_bands(values: F, rate_Hz: float, edges_Hz: F) -> F:
    """Return the parts (n, m) of a series (n,) in bands that cover all frequencies; energies over bands add up.

    By the orthogonal cosine transform, which continues a series by its mirror image and so sees no step at its ends.
    """
    spectra = spectra_of([values], [rate_Hz], edges_Hz)
    masked = spectra.line[:, None] * (spectra.band[:, None] == np.arange(spectra.count))
    return np.asarray(idct(masked, axis=0, norm="ortho"))


def ar_spectrum(noise: NoiseModel, frequency_Hz: F, rate_Hz: float) -> F:
    """Return the spectrum (n,) of autoregressive noise, to scale 1 for what is new in each tick."""
    lag = np.exp(-2j * np.pi * frequency_Hz[:, None] / rate_Hz * np.arange(1, len(noise.ar) + 1))
    return np.asarray(np.abs(1.0 - lag @ noise.ar) ** -2.0)


def estimate_noise_variance(whole: Spectra, rest: Spectra, noise_energy: float) -> F:
    """Return the noise's variance (m,) [N2 per line] in each band, from what cannot be predicted there.

    That may be more than noise: noise is what lies below a level, such that its sum is the `noise_energy` one [N2]
    (reverse water-filling: Cover and Thomas, Elements of Information Theory, 2nd ed., section 10.3.3).
    """
    count = np.maximum(whole.sums(np.ones_like(whole.line)), 1.0)
    density = np.minimum(whole.sums(whole.line**2), rest.sums(rest.line**2)) / count
    order = np.argsort(density)
    below = np.concatenate([[0.0], np.cumsum((density * count)[order])[:-1]])
    above = np.cumsum(count[order][::-1])[::-1]
    level = (noise_energy - below) / above
    reached = np.flatnonzero(level <= density[order])
    return np.minimum(density, level[reached[0]]) if len(reached) else density
