"""Where the gap lies: its energy over the damper's operating range, with intervals and control of false discoveries.

Each axis is divided into regions. A region has a share of the gap's energy and of the time, and the gap's RMS with a
block-bootstrap interval. Its mean energy is compared with that of the rest of its axis; the null distribution comes
from redrawing blocks of the energy at random. The largest excess over all regions is compared with the largest of each
redraw, with every region on the scale of its own null, so that a rare region counts as much as a common one. A
frequency band exceeds the rest if its share of the gap's energy is larger than its share of the force's energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.trace import F, Trace
from ces_gap.where.axes import FREQUENCY, OPERATING, I, axis_edges, axis_values, region_indices
from ces_gap.where.block_bootstrap import (
    block_s,
    effective_blocks,
    normal_scores,
    p_value_of_largest,
    q_values,
    resampled_sums,
    scattered_sums,
    t_interval,
)
from ces_gap.where.gap_energy import Energy, NoiseSpec, gap_energy
from ces_gap.where.maps import compute_gap_maps
from ces_gap.where.regions import GapRegion, Where

RESAMPLES = 400
RESOLVED = 1e-9  # of the mean energy: a smaller excess is a rounding error
CELLS = 12_000  # approximate number of cells into which ticks are merged for resampling


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


def locate(traces: Sequence[Trace], gap: Sequence[F], noise: NoiseSpec, seed: int = 1) -> Where:
    """Return where gaps [N] (n,), measured minus simulated force on the grids of traces, lie.

    `share_of_samples` is the share of the time; for frequency bands, that of the measured force's energy. `strongest`
    is the operating region with the largest standardised excess. Raises GapError for too few ticks or a gap that is
    not finite.
    """
    energy = gap_energy(traces, gap, noise)
    values = _values(traces)
    axes = [_Axis(n, e, region_indices(e, values[n])) for n, e in ((n, axis_edges(n, values[n])) for n in OPERATING)]
    cells = _cells(energy, axes)
    length = _block(cells)
    rng = np.random.default_rng(seed)
    scores, draws = _operating_scores(cells, axes, length, rng)
    band_scores, band_errors, errors = _bootstrap_errors(cells, energy, length, rng)
    alone = np.concatenate([[len(a.edges) == 2] * (len(a.edges) - 1) for a in axes] + [[False] * len(band_scores)])
    q = np.where(alone, 1.0, q_values(np.concatenate([scores, band_scores])))
    regions = [
        *_operating_regions(energy, axes, errors, effective_blocks(cells.seconds, length), q),
        *_band_regions(energy, band_errors, len(cells.energy) / length, q[len(scores) :]),
    ]
    return Where(
        tuple(sorted(regions, key=lambda r: -r.share_of_energy)),
        regions[int(np.argmax(scores))] if scores.max() > 0.0 else None,
        p_value_of_largest(scores, draws),
        compute_gap_maps(values, energy.tick),
    )


def rms_within_regions(
    regions: Sequence[GapRegion], traces: Sequence[Trace], gap: Sequence[F], noise: NoiseSpec
) -> tuple[float, ...]:
    """Return the RMS [N] of another gap in each region, without noise, which shows where the gap shrank."""
    values = _values(traces)
    bands = [r for r in regions if r.axis == FREQUENCY]
    edges = np.unique([0.0, max(t.rate_Hz for t in traces) / 2.0, *(e for r in bands for e in (r.low, r.high))])
    energy = gap_energy(traces, gap, noise, edges)
    return tuple(_root(_mean_within(r, energy, values)) for r in regions)


def _mean_within(region: GapRegion, energy: Energy, values: dict[str, F]) -> float:
    if region.axis == FREQUENCY:
        inside = (energy.edges_Hz[:-1] >= region.low) & (energy.edges_Hz[1:] <= region.high)
        return float(np.average(energy.band[:, inside].sum(axis=1), weights=energy.step_s))
    along = values[region.axis]
    weight = energy.step_s * ((along >= region.low) & (along <= region.high))
    return float(energy.tick @ weight) / max(float(weight.sum()), 1e-300)


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


def _block(cells: _Cells) -> int:
    """Return the number of cells in a block."""
    cell_s = float(cells.seconds.sum()) / len(OPERATING) / len(cells.energy)
    return max(1, round(block_s(cells.energy, cell_s) / cell_s))


def _operating_scores(cells: _Cells, axes: Sequence[_Axis], length: int, rng: np.random.Generator) -> tuple[F, F]:
    """Return the normal scores (r,) of regions' excess over the rest of their axes, and those of redraws (b, r)."""
    first = len(axes[0].edges) - 1
    members = np.c_[cells.seconds, cells.seconds[:, :first].sum(axis=1)]
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


def _operating_regions(energy: Energy, axes: Sequence[_Axis], errors: F, blocks: F, q: F) -> list[GapRegion]:
    regions: list[GapRegion] = []
    for axis in axes:
        part = slice(len(regions), len(regions) + len(axis.edges) - 1)
        seconds = _sums(axis, energy.step_s)
        sums = _sums(axis, energy.tick * energy.step_s)
        ends = t_interval(sums / seconds, errors[part], blocks[part])
        regions += _regions(axis.name, axis.edges, sums, seconds, (sums / seconds, *ends), q[part])
    return regions


def _sums(axis: _Axis, weight: F) -> F:
    return np.bincount(axis.code, weight, minlength=len(axis.edges) - 1).astype(np.float64)


def _band_regions(energy: Energy, errors: F, blocks: float, q: F) -> list[GapRegion]:
    means = np.average(energy.band, axis=0, weights=energy.step_s)
    ends = t_interval(means, errors, np.full(len(means), blocks))
    return _regions(FREQUENCY, energy.edges_Hz, means, energy.force, (means, *ends), q)


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
