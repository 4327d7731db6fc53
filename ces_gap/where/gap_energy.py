"""How much of a gap is real: its energy at every tick and in every frequency band, measurement noise taken out.

That is the gap's square less the noise's variance. Where that is not known, the generic learner predicts each block of
the gap from what it learnt on others, and what it leaves counts as noise: the mean energy is then the cross-fitted
explained one, never too large on average, and a gap that the learner cannot see still stands out where it lies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import learn
from ces_gap.baseline.noise import NoiseModel
from ces_gap.errors import GapError
from ces_gap.trace import Trace, require_usable
from ces_gap.where.bands import ar_spectrum, estimate_noise_variance, octaves, spectra_of, split_into_bands

F = NDArray[np.float64]
NoiseSpec = (
    NoiseModel | float | Sequence[float] | None
)  # the noise: with its autocorrelation; RMS [N], or of each trace; unknown


@dataclass(frozen=True)
class Energy:
    """The energy of a gap [N2] on the usable ticks of all recordings, end to end; means may be negative.

    `step_s` (n,); `tick` (n,); `band` (n, m) between `edges_Hz` (m+1,), which over all ticks sum to the same. For each
    band `noise_error` (m,) is what the noise alone leaves uncertain of its mean energy, `lines` (m,) the number of
    spectral lines in it, and `force` (m,) its share of the measured force's energy.
    """

    step_s: F
    tick: F
    band: F
    edges_Hz: F
    noise_error: F
    lines: F
    force: F


def gap_energy(
    traces: Sequence[Trace],
    gap: Sequence[F],
    noise: NoiseSpec,
    predicted: Sequence[F] | None = None,
    edges_Hz: F | None = None,
) -> Energy:
    """Return the energy of gaps [N] (n,) on the grids of traces.

    `noise` is known with its autocorrelation, by its RMS [N] per tick for all traces or each, or not (None).
    `predicted` are cross-fitted predictions of the gaps, made here if needed. Raises GapError if a gap is not finite
    at usable ticks.
    """
    series, rates = [_usable(t, g) for t, g in zip(traces, gap, strict=True)], [t.rate_Hz for t in traces]
    edges = octaves(series, rates) if edges_Hz is None else edges_Hz
    spectra, lengths = spectra_of(series, rates, edges), [len(y) for y in series]
    if isinstance(noise, NoiseModel):
        rms, shape = np.full(len(series), noise.rms_N), ar_spectrum(noise, spectra.frequency, rates[0])
    else:
        predicted = cross_fit_gap(traces, gap) if predicted is None else predicted
        rests = [y - p[t.usable] for t, y, p in zip(traces, series, predicted, strict=True)]
        rms = _noise_rms_N(noise, series, rests)
        wanted = float(np.repeat(rms**2, lengths).sum())
        shape = estimate_noise_variance(spectra, spectra_of(rests, rates, edges), wanted)[spectra.band]
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
    """Return predictions [N] (n,) of gaps from the inputs, each block's learnt on other blocks."""
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
    """Return the RMS [N] of each trace's noise, of what the learner leaves if it is not given."""
    if noise is not None:
        return np.array(np.broadcast_to(np.asarray(noise, dtype=np.float64), (len(series),)))
    left, whole = (float((np.concatenate(parts) ** 2).mean()) for parts in (rests, series))
    return np.full(len(series), np.sqrt(min(left, whole)))


def _scale_to_rms(shape: F, rms_N: F, lengths: Sequence[int]) -> F:
    """Return a spectrum (n,) with the variance of each trace's noise on its lines [N2 per line]."""
    starts = np.cumsum([0, *lengths[:-1]])
    mean = np.add.reduceat(shape, starts) / np.asarray(lengths)
    scaled: F = shape * np.repeat(rms_N**2 / np.maximum(mean, 1e-300), lengths)
    return scaled


def _force_share(traces: Sequence[Trace], edges_Hz: F) -> F:
    spectra = spectra_of([t.force[t.usable] for t in traces], [t.rate_Hz for t in traces], edges_Hz)
    energy = spectra.sums(spectra.line**2)
    return energy / max(float(energy.sum()), 1e-300)
