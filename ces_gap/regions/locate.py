"""Where the gap lies: its energy over the damper's operating range, with intervals and control of false discoveries.

Each axis is divided into regions. The mean energy of a region is compared with that of the rest of its axis; the null
distribution comes from redrawing blocks of the energy at random. The largest excess over all regions is compared with
the largest of each redraw, with every region on the scale of its own null, so that a rare region counts as much as a
common one. A frequency band exceeds the rest if its share of the gap's energy is larger than its share of the force's.

Recordings are concatenated and closed to a circle, so that every tick is drawn equally often (circular blocks: Politis
and Romano 1992). The few blocks that cross from one recording to the next do no harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.stats import false_discovery_control, norm
from scipy.stats import t as student

from ces_data.arrays import F, I
from ces_gap.baseline.learner import NoiseModel
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.held_out import HeldOutSeries
from ces_gap.regions.axes import (
    FREQUENCY,
    MAPS,
    OPERATING,
    GapRegion,
    Where,
    axis_edges,
    axis_values,
    compute_gap_map,
    region_indices,
)
from ces_gap.regions.energy import Energy, gap_energy
from ces_gap.trace import Trace

BLOCK_S = (0.25, 1.0)
BLOCK_LAGS = 6.0  # length of a block over that of the autocorrelation
QUIET_S = 0.05  # [s] for which the autocorrelation must stay insignificant
CHUNK = 2_000_000  # numbers drawn at once
RESAMPLES = 400
RESOLVED = 1e-9  # of the mean energy: a smaller excess is a rounding error
CELLS = 12_000  # approximate number of cells into which ticks are merged for resampling


def block_s(series: F, step_s: float) -> float:
    """Return the length of blocks [s]: several times the lag at which the autocorrelation becomes insignificant.

    It is insignificant if it stays below 2√(log₁₀ n / n) for a while (Politis and White 2004); the zero crossings of a
    periodic series do not count.
    """
    n, centred = len(series), series - series.mean()
    size = next_fast_len(2 * n)
    acf = np.abs(irfft(np.abs(rfft(centred, size)) ** 2, size)[: n // 2])
    quiet = acf < 2.0 * np.sqrt(np.log10(n) / n) * acf[0]
    run = max(1, round(QUIET_S / step_s))
    quiet_runs = np.flatnonzero(np.convolve(quiet, np.ones(run), mode="valid") > run - 0.5)
    lag = float(quiet_runs[0]) if len(quiet_runs) else float(n)
    return float(np.clip(BLOCK_LAGS * lag * step_s, *BLOCK_S))


def resampled_sums(series: F, length: int, resamples: int, rng: np.random.Generator) -> F:
    """Return the sums (resamples, m) of series (n, m) over n ticks drawn in blocks of `length` ticks."""
    n = len(series)
    length = min(length, n)
    starts = _starts(n, length, resamples, rng)
    running = np.concatenate([np.zeros((1, series.shape[1])), np.cumsum(np.r_[series, series[:length]], axis=0)])
    out = np.zeros((resamples, series.shape[1]))
    for start in starts.T:
        out += running[start + length] - running[start]
    out *= n / (starts.shape[1] * length)
    return out


def scattered_sums(series: F, members: F, length: int, resamples: int, rng: np.random.Generator) -> F:
    """Return sums over regions (resamples, m) of a series (n,) whose blocks are drawn at random.

    `members` (n, m) is the weight of each tick in each region and stays in place. This breaks any relation between the
    series and the regions, but keeps the autocorrelation within blocks.
    """
    n = len(series)
    length = min(length, n)
    starts = _starts(n, length, resamples, rng)
    doubled = np.r_[series, series[:length]]
    out = []
    for chunk in np.array_split(starts, max(1, resamples * n // CHUNK)):
        drawn = doubled[chunk[:, :, None] + np.arange(length)].reshape(len(chunk), -1)[:, :n]
        out.append(drawn @ members)
    return np.concatenate(out)


def t_interval(value: F, error: F, blocks: F) -> tuple[F, F]:
    """Return the 95 % intervals of means over so many `blocks` each, from their bootstrap standard errors.

    With k blocks the bootstrap error is too small by √((k−1)/k), and the tails of the normal distribution are too thin.
    """
    k = np.maximum(blocks, 2.0)
    half = student.ppf(0.975, k - 1.0) * error * np.sqrt(k / (k - 1.0))
    return np.asarray(value - half), np.asarray(value + half)


def effective_blocks(members: F, length: int) -> F:
    """Return the effective number of blocks of `length` ticks in each region (Kish), from the weights (n, m)."""
    starts = np.arange(0, len(members), length)
    weight = np.add.reduceat(members, starts, axis=0)
    return np.asarray(weight.sum(axis=0) ** 2 / np.maximum((weight**2).sum(axis=0), 1e-300))


def normal_scores(value: F, draws: F, min_spread: F | float, min_skew: F | float = 0.01) -> tuple[F, F]:
    """Return standard normal scores of values (m,) and of all draws (b, m) of their null distributions of mean 0.

    The null is a gamma distribution with the draws' spread and skewness, but at least `min_spread` and `min_skew`, as
    is usual for permutation tests (Mielke and Berry 2007). Wilson and Hilferty's cube root makes it normal, which
    resolves probabilities below 1/b.
    """
    spread = np.maximum(np.sqrt((draws**2).mean(axis=0)), np.maximum(min_spread, 1e-100))
    skew = np.clip(((draws / spread) ** 3).mean(axis=0), min_skew, 4.0)

    def score(x: F) -> F:
        root = np.cbrt(np.maximum(1.0 + 0.5 * skew * (x / spread), 0.0))
        return np.asarray(6.0 / skew * (root - 1.0) + skew / 6.0)

    return score(value), score(draws)


def p_value_of_largest(scores: F, draws: F) -> float:
    """Return the share of the draws (b, m) whose largest score reaches the largest of the scores (m,)."""
    count = int((draws.max(axis=1) >= scores.max()).sum())
    return (1.0 + count) / (1.0 + len(draws))


def q_values(scores: F) -> F:
    """Return the false-discovery rates (m,) of one-sided normal scores (Benjamini and Hochberg 1995)."""
    return np.asarray(false_discovery_control(norm.sf(scores)))


def _starts(n: int, length: int, resamples: int, rng: np.random.Generator) -> I:
    return rng.integers(0, n, (resamples, -(-n // length)))


@dataclass(frozen=True)
class _Axis:
    """The regions of one operating axis: `edges` (m+1,), and the region `code` (n,) of each tick."""

    name: str
    edges: F
    code: I


@dataclass(frozen=True)
class _Cells:
    """Runs of a few ticks: mean energy (c,), `seconds` in operating regions (c, r), energy in bands (c, m) [N² s]."""

    energy: F
    seconds: F
    band: F


def locate(traces: Sequence[Trace], gap: Sequence[F], noise: NoiseModel, seed: int = 1) -> Where:
    """Return where gaps [N] (n,), measured minus simulated force on the grids of traces, lie.

    `share_of_samples` is the share of the time; for frequency bands, that of the measured force's energy. `strongest`
    is the operating region with the largest standardised excess. Raises GapError for too few ticks or a gap that is
    not finite.
    """
    energy = gap_energy(traces, gap, noise)
    values = _values(traces)
    axes = [_Axis(n, e, region_indices(e, values[n])) for n, e in ((n, axis_edges(n, values[n])) for n in OPERATING)]
    cells = _cells(energy, axes)
    cell_s = float(cells.seconds.sum()) / len(OPERATING) / len(cells.energy)
    length = max(1, round(block_s(cells.energy, cell_s) / cell_s))  # of a block, in cells
    rng = np.random.default_rng(seed)
    scores, draws = _operating_scores(cells, axes, length, rng)
    band_scores, band_errors, errors = _bootstrap_errors(cells, energy, length, rng)
    alone = np.concatenate([[len(a.edges) == 2] * (len(a.edges) - 1) for a in axes] + [[False] * len(band_scores)])
    q = np.where(alone, 1.0, q_values(np.concatenate([scores, band_scores])))
    regions: list[GapRegion] = []
    blocks = effective_blocks(cells.seconds, length)
    for axis in axes:
        part = slice(len(regions), len(regions) + len(axis.edges) - 1)
        weights = (energy.step_s, energy.tick * energy.step_s)
        seconds, sums = (np.bincount(axis.code, w, minlength=len(axis.edges) - 1).astype(np.float64) for w in weights)
        ends = t_interval(sums / seconds, errors[part], blocks[part])
        regions += _regions(axis.name, axis.edges, sums, seconds, (sums / seconds, *ends), q[part])
    means = np.average(energy.band, axis=0, weights=energy.step_s)
    ends = t_interval(means, band_errors, np.full(len(means), len(cells.energy) / length))
    regions += _regions(FREQUENCY, energy.edges_Hz, means, energy.force, (means, *ends), q[len(scores) :])
    return Where(
        tuple(sorted(regions, key=lambda r: -r.share_of_energy)),
        regions[int(np.argmax(scores))] if scores.max() > 0.0 else None,
        p_value_of_largest(scores, draws),
        tuple(compute_gap_map(axes, values, energy.tick) for axes in MAPS),
    )


def rms_within_regions(
    regions: Sequence[GapRegion], traces: Sequence[Trace], gap: Sequence[F], noise: NoiseModel
) -> tuple[float, ...]:
    """Return the RMS [N] of another gap in each region, without noise, which shows where the gap shrank."""
    values = _values(traces)
    bands = [r for r in regions if r.axis == FREQUENCY]
    edges = np.unique([0.0, max(t.rate_Hz for t in traces) / 2.0, *(e for r in bands for e in (r.low, r.high))])
    energy = gap_energy(traces, gap, noise, edges)

    def mean_within(region: GapRegion) -> float:
        if region.axis == FREQUENCY:
            inside = (edges[:-1] >= region.low) & (edges[1:] <= region.high)
            return float(np.average(energy.band[:, inside].sum(axis=1), weights=energy.step_s))
        along = values[region.axis]
        weight = energy.step_s * ((along >= region.low) & (along <= region.high))
        return float(energy.tick @ weight) / max(float(weight.sum()), 1e-300)

    return tuple(_root(mean_within(r)) for r in regions)


def _values(traces: Sequence[Trace]) -> dict[str, F]:
    """Return the values of each operating axis on the usable ticks of all traces."""
    parts = [(t.usable, axis_values(t)) for t in traces]
    return {name: np.concatenate([v[name][u] for u, v in parts]) for name in OPERATING}


def _cells(energy: Energy, axes: Sequence[_Axis]) -> _Cells:
    size = max(1, round(len(energy.tick) / CELLS))
    starts = np.arange(0, len(energy.tick), size)
    seconds = np.add.reduceat(energy.step_s, starts)
    member = np.concatenate([a.code[:, None] == np.arange(len(a.edges) - 1) for a in axes], axis=1)
    return _Cells(
        np.add.reduceat(energy.tick * energy.step_s, starts) / seconds,
        np.add.reduceat(member * energy.step_s[:, None], starts, axis=0),
        np.add.reduceat(energy.band * energy.step_s[:, None], starts, axis=0),
    )


def _operating_scores(cells: _Cells, axes: Sequence[_Axis], length: int, rng: np.random.Generator) -> tuple[F, F]:
    """Return the normal scores (r,) of regions' excess over the rest of their axes, and those of redraws (b, r)."""
    of_first_axis = len(axes[0].edges) - 1
    members = np.c_[cells.seconds, cells.seconds[:, :of_first_axis].sum(axis=1)]
    within = members.sum(axis=0)

    def excess(sums: F) -> F:
        rest = np.maximum(within[-1] - within[:-1], 1e-9 * within[-1])
        alone = within[:-1] > (1.0 - 1e-9) * within[-1]
        difference = sums[:, :-1] / within[:-1] - (sums[:, -1:] - sums[:, :-1]) / rest
        return np.where(alone, 0.0, difference)

    scattered = scattered_sums(cells.energy, members, length, RESAMPLES, rng)
    min_spread = RESOLVED * float(np.abs(cells.energy).mean())
    return normal_scores(excess((cells.energy @ members)[None, :])[0], excess(scattered), min_spread)


def _bootstrap_errors(cells: _Cells, energy: Energy, length: int, rng: np.random.Generator) -> tuple[F, F, F]:
    """Return scores of the bands (m,), and standard errors of mean energies [N2] in bands (m,) and regions (r,).

    A mean is a ratio of sums; its linearisation is resampled, because a resample may miss a region. Blocks are too
    short for the slowest bands: their errors and skewness are at least those of Gaussian noise.
    """
    within, total_s = cells.seconds.sum(axis=0), float(energy.step_s.sum())
    means = cells.energy @ cells.seconds / within
    regions = (cells.energy[:, None] - means) * cells.seconds / within
    bands = cells.band / total_s
    over_force = bands - energy.force * bands.sum(axis=1, keepdims=True)
    excess = over_force.sum(axis=0)
    series = np.concatenate([regions, bands - bands.mean(axis=0), over_force - over_force.mean(axis=0)], axis=1)
    sums = resampled_sums(series, length, RESAMPLES, rng)
    r, m = len(within), bands.shape[1]
    errors, draws = sums[:, : r + m].std(axis=0), sums[:, r + m :]
    scores = normal_scores(excess, draws, energy.noise_error, np.sqrt(8.0 / energy.lines))[0]
    return scores, np.maximum(errors[r:], energy.noise_error), errors[:r]


def _regions(axis: str, edges: F, sums: F, amount: F, means: tuple[F, F, F], q: F) -> list[GapRegion]:
    """Return regions from sums of energy, amounts of samples, and mean energies with their intervals."""
    positive = np.maximum(sums, 0.0)
    share = positive / max(float(positive.sum()), 1e-300)
    return [
        GapRegion(
            axis=axis,
            low=float(edges[k]),
            high=float(edges[k + 1]),
            share_of_energy=float(share[k]),
            share_of_samples=float(amount[k] / amount.sum()),
            rms_N=_root(means[0][k]),
            ci95_N=(_root(means[1][k]), _root(means[2][k])),
            q_value=float(q[k]),
        )
        for k in range(len(share))
    ]


def _root(energy: float) -> float:
    return float(np.sqrt(max(energy, 0.0)))


@dataclass(frozen=True)
class GapLocation:
    """Where the gap lies, the gap after [N] in each of its regions, and where the rest lies if requested."""

    where: Where
    by_region: tuple[tuple[GapRegion, float], ...]
    rest: Where | None


NOWHERE = GapLocation(Where((), None, 1.0, ()), (), None)


def locate_gap(
    evidence: Evidence, held_out: Sequence[HeldOutSeries], seed: int, with_rest: bool, of_original: bool = False
) -> GapLocation:
    """Return where the gap of all recordings lies, and what is left of it in each region of held-out recordings.

    It is the gap after the correction, or that `of_original`, which parameters have closed.
    """
    held_out_traces, noise = [s.trace for s in held_out], evidence.noise
    traces, before = [*evidence.traces, *held_out_traces], [*evidence.alone, *(s.corrected for s in held_out)]
    before = [t.simulated_as_logged for t in traces] if of_original else before
    gap = [t.force - f for t, f in zip(traces, before, strict=True)]
    after = [s.trace.force - s.augmented for s in held_out]
    where = locate(traces, gap, noise, seed)
    within = rms_within_regions(where.regions, held_out_traces, after, noise)
    rest = locate(held_out_traces, after, noise, seed) if with_rest else None
    return GapLocation(where, tuple(zip(where.regions, within, strict=True)), rest)
