"""How sure a cost J is: its bootstrap interval over the scored ticks of a free run, each recording's or several's.

J is a ratio of two sums, and both are resampled together: a replicate takes whole blocks of ticks, with their squared
errors and their measured forces, and takes its own mean force. Blocks (circular within a run, so that every tick is
as likely as any other: Politis & Romano 1992) keep what neighbours have in common; none spans a gap. Their length is
the automatic choice of Politis and White for the influence of a tick on J,

    e^2 / mean(e^2) - (y - mean y)^2 / var(y),

averaged over BIN_S. Percentiles are expanded for the number of blocks (Hesterberg, The American Statistician 69, 2015,
sec. 3.3): with few, plain ones are too narrow. The interval tells how J would vary over other stretches of the same
experiment. It treats the recording as stationary: on a sweep it says how much J hangs on which part was driven.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ces_identify.numerics.arrays import F, I
from ces_identify.numerics.correlation import block_length, find_runs
from ces_identify.validation.evaluate import Evaluation

LEVEL = 0.95
REPLICATES = 2000
BIN_S = 0.01  # [s] far below the time over which a damper's errors hang together
MIN_BLOCKS = 8
AT_ONCE = 2_000_000  # blocks drawn at a time


@dataclass(frozen=True)
class CostInterval:
    """J from `low` to `high` [%] with a probability of LEVEL, from `blocks` blocks of at most `block_s` [s]."""

    low: float
    high: float
    block_s: float
    blocks: int


@dataclass(frozen=True)
class Ticks:
    """The scored ticks of a run: squared `error` (n,) [N2], measured `force` (n,) [N] and the runs (r, 2)."""

    squares: F
    force: F
    runs: I


def cost_interval(evaluations: Sequence[Evaluation], seed: int = 0) -> CostInterval | None:
    """Return the interval of J over `evaluations` taken together; None if a run diverged or is too short to tell.

    J of several is over all their ticks, each about its own recording's mean force; each recording is resampled by
    itself.
    """
    random = np.random.default_rng(seed)
    total, facts = np.zeros((REPLICATES, 2)), []
    for evaluation in evaluations:
        if not np.isfinite(evaluation.cost):
            return None
        ticks, bin_ticks = scored_ticks(evaluation), max(1, round(BIN_S * evaluation.series.rate_Hz))
        length = influence_block(ticks, bin_ticks)
        if len(ticks.force) < MIN_BLOCKS * length:
            return None
        total += replicates(ticks, length, random)
        facts.append((length / evaluation.series.rate_Hz, len(ticks.force) // length))
    blocks = sum(f[1] for f in facts)
    low, high = interval_of(100.0 * np.sqrt(total[:, 0] / total[:, 1]), blocks)
    return CostInterval(low, high, max(f[0] for f in facts), blocks)


def interval_of(replicated: F, blocks: int) -> tuple[float, float]:
    """Return the interval of replicates (n,) made of `blocks` blocks each, its percentiles expanded."""
    reach = float(np.sqrt(blocks / (blocks - 1.0)) * student.ppf(0.5 + LEVEL / 2, blocks - 1))
    tail = float(norm.sf(reach))
    low, high = np.quantile(replicated, [tail, 1.0 - tail])
    return float(low), float(high)


def pooled_cost(evaluations: Sequence[Evaluation]) -> float:
    """Return J [%] over all ticks of `evaluations`, each about its own recording's mean force."""
    ticks = [scored_ticks(e) for e in evaluations]
    spread = sum(float(((t.force - t.force.mean()) ** 2).sum()) for t in ticks)
    return float(100.0 * np.sqrt(sum(float(t.squares.sum()) for t in ticks) / spread))


def scored_ticks(evaluation: Evaluation) -> Ticks:
    """Return the scored ticks of `evaluation`."""
    series = evaluation.series
    return Ticks(evaluation.error**2, series.force[series.scored], find_runs(series.scored, series.segments))


def influence_block(ticks: Ticks, bin_ticks: int) -> int:
    """Return the block length [ticks] for `ticks`, a multiple of `bin_ticks`."""
    centred = (ticks.force - ticks.force.mean()) ** 2
    influence = ticks.squares / max(float(ticks.squares.mean()), 1e-300) - centred / centred.mean()
    binned, runs = _average_bins(influence, ticks.runs, bin_ticks)
    return bin_ticks * block_length(binned, runs) if len(binned) > 3 * MIN_BLOCKS else len(influence)


def replicates(ticks: Ticks, length: int, random: np.random.Generator) -> F:
    """Return sums of squared errors and of squared distances from the mean force (REPLICATES, 2), resampled."""
    blocks, odds = _block_sums(ticks, length)
    chosen = -(-len(ticks.force) // length)
    edges = np.cumsum(odds) / odds.sum()
    rows = max(1, AT_ONCE // chosen)
    sums = np.concatenate(
        [
            blocks[np.searchsorted(edges, random.random((min(rows, REPLICATES - i), chosen)), "right")].sum(axis=1)
            for i in range(0, REPLICATES, rows)
        ]
    )
    spread = sums[:, 2] - sums[:, 1] ** 2 / sums[:, 3]
    return np.stack([sums[:, 0], spread], axis=1) * (len(ticks.force) / sums[:, 3])[:, None]


def _block_sums(ticks: Ticks, length: int) -> tuple[F, F]:
    """Return, for the block that begins at each tick, the sums (n, 4) of e^2, y, y^2 and 1, and its odds (n,).

    A run shorter than a block is a block by itself; the odds make up for its fewer ticks.
    """
    y = ticks.force - ticks.force.mean()
    columns = np.stack([ticks.squares, y, y**2, np.ones(len(y))], axis=1)
    sums, odds = np.empty_like(columns), np.empty(len(y))
    for start, stop in ticks.runs:
        n = min(length, int(stop - start))
        circle = np.concatenate([columns[start:stop], columns[start : start + n]])
        before = np.concatenate([np.zeros((1, 4)), np.cumsum(circle, axis=0)])
        sums[start:stop] = before[n : n + stop - start] - before[: stop - start]
        odds[start:stop] = 1.0 / n
    return sums, odds


def _average_bins(x: F, runs: I, ticks: int) -> tuple[F, I]:
    """Return the means of x over whole bins of `ticks` inside runs, and the runs of the bins."""
    parts = [x[a : a + (b - a) // ticks * ticks].reshape(-1, ticks).mean(axis=1) for a, b in runs if b - a >= ticks]
    ends = np.cumsum([len(p) for p in parts])
    return np.concatenate([np.empty(0), *parts]), np.stack([np.append(0, ends[:-1])[: len(ends)], ends], axis=1)
