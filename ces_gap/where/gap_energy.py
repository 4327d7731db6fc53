"""The energy of a gap at every tick and in every frequency band, without measurement noise.

It is the square of the gap minus the variance of the noise. If that is unknown, the generic learner predicts each block
of the gap from the other blocks, and its residual counts as noise. The mean energy is then not too large on average,
and a gap that the learner cannot predict still shows where it is concentrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import learn
from ces_gap.baseline.noise import NoiseModel
from ces_gap.errors import GapError
from ces_gap.trace import F, Trace, require_usable
from ces_gap.where.bands import ar_spectrum, estimate_noise_variance, octaves, spectra_of, split_into_bands

NoiseSpec = NoiseModel | float | Sequence[float] | None  # autocorrelated; RMS [N], of all or each trace; unknown


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


def gap_energy(traces: Sequence[Trace], gap: Sequence[F], noise: NoiseSpec, edges_Hz: F | None = None) -> Energy:
    """Return the energy of gaps [N] (n,) on the grids of traces, in bands between `edges_Hz` (octaves by default).

    Raises GapError if a gap is not finite at usable ticks.
    """
    series, rates = [_usable(t, g) for t, g in zip(traces, gap, strict=True)], [t.rate_Hz for t in traces]
    edges = octaves(series, rates) if edges_Hz is None else edges_Hz
    spectra, lengths = spectra_of(series, rates, edges), [len(y) for y in series]
    if isinstance(noise, NoiseModel):
        rms, shape = np.full(len(series), noise.rms_N), ar_spectrum(noise, spectra.frequency, rates[0])
    else:
        predicted = cross_fit_gap(traces, gap)
        rests = [y - p[t.usable] for t, y, p in zip(traces, series, predicted, strict=True)]
        rms = _noise_rms_N(noise, series, rests)
        noise_energy = float(np.repeat(rms**2, lengths).sum())
        shape = estimate_noise_variance(spectra, spectra_of(rests, rates, edges), noise_energy)[spectra.band]
    floor = _scale_to_rms(shape, rms, lengths)
    parts = [split_into_bands(y, r, edges) ** 2 for y, r in zip(series, rates, strict=True)]
    owner = np.repeat(np.arange(len(series)), lengths)
    floors = np.stack([spectra.sums(floor * (owner == k)) / n for k, n in enumerate(lengths)])
    return Energy(
        step_s=np.repeat([t.step_s for t in traces], lengths),
        tick=np.concatenate(series) ** 2 - (rms**2)[owner],
        band=np.concatenate(parts) - floors[owner],
        edges_Hz=edges,
        noise_error=np.sqrt(np.maximum(spectra.sums(4.0 * floor * spectra.line**2 - 2.0 * floor**2), 0.0)) / len(owner),
        lines=spectra.sums(np.ones_like(floor)),
        force=_force_share(traces, edges),
    )


def cross_fit_gap(traces: Sequence[Trace], gap: Sequence[F]) -> tuple[F, ...]:
    """Return predictions [N] (n,) of gaps from the inputs; each block is predicted from the other blocks."""
    dictionary = Dictionary(Scales.of(traces, [t.simulated for t in traces]), by_time=True)
    features = [dictionary.features(t, t.inputs, t.simulated) for t in traces]
    return learn(features, gap, [t.usable for t in traces], traces[0].rate_Hz, passes=1).crossfitted


def _usable(trace: Trace, gap: F) -> F:
    require_usable(trace)
    if gap.shape != trace.time_s.shape or not np.isfinite(gap[trace.usable]).all():
        raise GapError(
            f"{trace.name}: a gap of shape {gap.shape}, {int((~np.isfinite(gap)).sum())} not finite; expected "
            f"{trace.time_s.shape} and finite at usable ticks; check what the simulation returns"
        )
    return gap[trace.usable]


def _noise_rms_N(noise: float | Sequence[float] | None, series: Sequence[F], rests: Sequence[F]) -> F:
    """Return the RMS [N] of each trace's noise; if it is unknown, that of the learner's residual."""
    if noise is not None:
        return np.array(np.broadcast_to(np.asarray(noise, dtype=np.float64), (len(series),)))
    return np.full(len(series), np.sqrt(min(float((np.concatenate(y) ** 2).mean()) for y in (rests, series))))


def _scale_to_rms(shape: F, rms_N: F, lengths: Sequence[int]) -> F:
    """Return a spectrum (n,) [N² per line] of this shape, scaled to the RMS of each trace's noise."""
    starts = np.cumsum([0, *lengths[:-1]])
    mean = np.add.reduceat(shape, starts) / np.asarray(lengths)
    scaled: F = shape * np.repeat(rms_N**2 / np.maximum(mean, 1e-300), lengths)
    return scaled


def _force_share(traces: Sequence[Trace], edges_Hz: F) -> F:
    spectra = spectra_of([t.force[t.usable] for t in traces], [t.rate_Hz for t in traces], edges_Hz)
    energy = spectra.sums(spectra.line**2)
    return energy / max(float(energy.sum()), 1e-300)
