"""The confidence interval of a cost J, by a block bootstrap over the scored ticks of one or several free runs.

J is a ratio of two sums, which are resampled together: a replicate draws blocks of ticks with their squared errors and
measured forces, and takes its own mean force. Blocks preserve the correlation of neighbours. They are circular within a
run (Politis & Romano 1992), so that all ticks are equally likely, and never span a gap. Their length is the automatic
choice of Politis and White for the influence of a tick on J, averaged over BIN_S:

    e^2 / mean(e^2) - (y - mean y)^2 / var(y)

Percentiles are expanded for the number of blocks (Hesterberg, The American Statistician 69, 2015, sec. 3.3), because
plain ones are too narrow for few blocks. The interval says how J would vary over other stretches of the same
experiment, and treats the recording as stationary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from ces_identify.numerics.arrays import F, I
from ces_identify.numerics.block_sums import average_bins, resample_sums
from ces_identify.numerics.correlation import block_length, find_runs
from ces_identify.validation.evaluate import Evaluation

LEVEL = 0.95
REPLICATES = 2000
BIN_S = 0.01  # [s] far below the correlation time of a damper's errors
MIN_BLOCKS = 8


@dataclass(frozen=True)
class CostInterval:
    """J is between `low` and `high` [%] with probability LEVEL, by `blocks` blocks of at most `block_s` [s]."""

    low: float
    high: float
    block_s: float
    blocks: int


@dataclass(frozen=True)
class Ticks:
    """The scored ticks of a run: `squares` of the error (n,) [N²], measured `force` (n,) [N] and `runs` (r, 2)."""

    squares: F
    force: F
    runs: I


def cost_interval(evaluations: Sequence[Evaluation], seed: int = 0) -> CostInterval | None:
    """Return the interval of J over all `evaluations` together; None if a run diverged or is too short.

    Errors and forces are pooled, each force relative to its recording's mean; each recording is resampled separately.
    """
    if not all(np.isfinite(evaluation.cost) for evaluation in evaluations):
        return None
    return interval_of_ticks([(scored_ticks(e), e.series.rate_Hz) for e in evaluations], seed)


def interval_of_ticks(runs: Sequence[tuple[Ticks, float]], seed: int = 0) -> CostInterval | None:
    """Return the interval of J over runs of finite forces, each with its rate [Hz]; None if one is too short."""
    random = np.random.default_rng(seed)
    total, blocks_of = np.zeros((REPLICATES, 2)), []
    for ticks, rate_Hz in runs:
        length = influence_block(ticks, max(1, round(BIN_S * rate_Hz)))
        if len(ticks.force) < MIN_BLOCKS * length:
            return None
        total += replicates(ticks, length, random)
        blocks_of.append((length / rate_Hz, len(ticks.force) // length))
    blocks = sum(count for _, count in blocks_of)
    low, high = interval_of(100.0 * np.sqrt(total[:, 0] / total[:, 1]), blocks)
    return CostInterval(low, high, max(seconds for seconds, _ in blocks_of), blocks)


def interval_of(replicated: F, blocks: int) -> tuple[float, float]:
    """Return the expanded percentile interval of replicates (n,) with `blocks` blocks each."""
    reach = float(np.sqrt(blocks / (blocks - 1.0)) * student.ppf(0.5 + LEVEL / 2, blocks - 1))
    tail = float(norm.sf(reach))
    low, high = np.quantile(replicated, [tail, 1.0 - tail])
    return float(low), float(high)


def pooled_cost(evaluations: Sequence[Evaluation]) -> float:
    """Return J [%] over all ticks of `evaluations`, each force relative to its recording's mean."""
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
    binned, runs = average_bins(influence, ticks.runs, bin_ticks)
    return bin_ticks * block_length(binned, runs) if len(binned) > 3 * MIN_BLOCKS else len(influence)


def replicates(ticks: Ticks, length: int, random: np.random.Generator) -> F:
    """Return sums of squared errors and of squared distances from the mean force (REPLICATES, 2), resampled."""
    y = ticks.force - ticks.force.mean()
    columns = np.stack([ticks.squares, y, y**2, np.ones(len(y))], axis=1)
    sums = resample_sums(columns, ticks.runs, length, REPLICATES, random)
    spread = sums[:, 2] - sums[:, 1] ** 2 / sums[:, 3]
    return np.stack([sums[:, 0], spread], axis=1) * (len(ticks.force) / sums[:, 3])[:, None]
