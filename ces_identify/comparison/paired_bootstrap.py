"""Differences of cost between models on the same recordings, by a paired block bootstrap.

A replicate draws the same blocks of time for all models, with their squared errors and the measured force, and so keeps
what their errors have in common. Each recording is resampled separately, in circular blocks (Politis & Romano 1992).
The standard error of a difference of J comes from the replicates, corrected for the number of blocks k by
sqrt(k / (k - 1)), and is compared with Student's t; over several recordings the degrees of freedom are Satterthwaite's.

One length of blocks is easily too short: errors of a damper vary with the excitation, far more slowly than from sample
to sample, and a bootstrap with short blocks then finds differences that are none. Therefore the bootstrap is repeated
with several lengths, and the widest interval counts: twice the automatic length of Politis and White for the influence
of a sample on the difference, and a twentieth, a tenth and a fifth of the recording (as in the t-tests over few large
blocks of Ibragimov and Mueller, Journal of Business & Economic Statistics 28, 2010). With fewer than MIN_BLOCKS
automatic blocks no answer is given, nor with an error that still grows by more than MAX_GROWTH from a twentieth to a
fifth, unless the difference is far beyond it (CLEAR). Variation slower than a fifth of the recording is not part of any
interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.stats import t as student

from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.numerics.arrays import F, I
from ces_identify.numerics.block_sums import resample_sums
from ces_identify.numerics.correlation import block_length

REPLICATES = 2000
BIN_S = 0.01  # [s] far below the correlation time of a damper's errors
MIN_BINS = 100  # of a recording: 1 s
MIN_BLOCKS = 6  # of the automatic length, over all recordings
MAX_GROWTH = 1.4
CLEAR = 0.001  # p-value of a difference that a growing error cannot explain
LARGE_BLOCKS = (20, 10, 5)  # blocks of a recording, for the longer lengths
MIN_SPREAD = 1e-6  # of the force in a replicate, for blocks of standstill alone
MAX_BLOCKS = 500  # of a recording: shorter blocks gain nothing

Pair = tuple[int, int]


@dataclass(frozen=True)
class DifferenceErrors:
    """A difference of J [%], first minus second model, and its standard errors.

    `errors` holds, for each length of blocks, the standard error [%] and its degrees of freedom. `blocks` counts the
    blocks of the automatic length, `block_s` [s] is the longest of those.
    """

    value: float
    errors: tuple[tuple[float, float], ...]
    blocks: int
    block_s: float

    @property
    def enough(self) -> bool:
        """Whether there are enough blocks for an interval, and blocks so long that a growing error does not matter."""
        if self.blocks < MIN_BLOCKS or not self.errors:
            return False
        _, (shorter, _), *_, (longest, _) = self.errors
        return longest <= MAX_GROWTH * shorter or self.p_value() < CLEAR

    def p_value(self) -> float:
        """Return the largest p-value over all lengths of blocks, that the true difference is zero."""
        return max(_p_value(self.value, error, freedom) for error, freedom in self.errors)

    def interval(self, level: float) -> tuple[float, float]:
        """Return the widest interval [%] over all lengths of blocks, which holds the true value by `level` (0 to 1)."""
        half = max(error * float(student.ppf(0.5 + level / 2.0, freedom)) for error, freedom in self.errors)
        return self.value - half, self.value + half


def pooled_costs(recordings: Sequence[AlignedRecording]) -> F:
    """Return J [%] of each model (models,) over all recordings, each force relative to its recording's mean."""
    squares = sum((r.errors**2).sum(axis=1) for r in recordings)
    spread = sum(float(((y - y.mean()) ** 2).sum()) for r in recordings for y in (r.measured[r.scored],))
    return np.asarray(100.0 * np.sqrt(squares / spread))


def find_differences(
    recordings: Sequence[AlignedRecording], pairs: Sequence[Pair], seed: int = 0
) -> list[DifferenceErrors]:
    """Return the difference of pooled J, with its errors, for each pair of models; none of them may have diverged."""
    if not pairs:
        return []
    models = sorted({model for pair in pairs for model in pair})
    local = [(models.index(a), models.index(b)) for a, b in pairs]
    binned = [_BinnedErrors.of(recording, models) for recording in recordings]
    sums = np.sum([b.columns.sum(axis=0) for b in binned], axis=0)
    totals = _Totals(sums, sum(b.spread for b in binned), len(models))
    automatic = np.array([[b.automatic_block(totals, pair) for pair in local] for b in binned])
    errors: list[list[tuple[float, float]]] = [[] for _ in pairs]
    if all(len(b.columns) >= MIN_BINS for b in binned):
        random = np.random.default_rng(seed)
        for lengths in _block_lengths(binned, automatic):
            for one, error in zip(errors, _errors(binned, lengths, totals, local, random), strict=True):
                one.append(error)
    return [
        DifferenceErrors(
            totals.difference(pair),
            tuple(errors[i]),
            int(sum(len(b.columns) // length for b, length in zip(binned, automatic[:, i], strict=True))),
            float(max(length * b.bin_s for b, length in zip(binned, automatic[:, i], strict=True))),
        )
        for i, pair in enumerate(local)
    ]


@dataclass(frozen=True)
class _Totals:
    """Sums over all recordings: squared errors of each model (models,) in `sums`, and of the force around its mean."""

    sums: F
    spread: float
    models: int

    @property
    def costs(self) -> F:
        return np.asarray(100.0 * np.sqrt(self.sums[: self.models] / self.spread))

    def difference(self, pair: Pair) -> float:
        return float(self.costs[pair[0]] - self.costs[pair[1]])

    def gradient(self, model: int) -> tuple[float, float]:
        """Return how J changes [%/N²] with the model's sum of squared errors and with that of the force."""
        half = 0.5 * float(self.costs[model])
        return half / max(float(self.sums[model]), 1e-300), -half / self.spread


@dataclass(frozen=True)
class _BinnedErrors:
    """Sums over bins of BIN_S: of each model's squared errors, y, y² and the ticks, in `columns` (bins, models + 3)."""

    columns: F
    bin_s: float

    @classmethod
    def of(cls, recording: AlignedRecording, models: Sequence[int]) -> _BinnedErrors:
        y = recording.measured[recording.scored]
        y = y - y.mean()
        columns = np.stack([*recording.errors[models] ** 2, y, y**2, np.ones(len(y))], axis=1)
        ticks = max(1, round(BIN_S * recording.rate_Hz))
        starts = np.arange(0, len(y), ticks)
        return cls(np.add.reduceat(columns, starts, axis=0), ticks / recording.rate_Hz)

    @property
    def spread(self) -> float:
        return float(self.columns[:, -2].sum())

    def influence(self, totals: _Totals, pair: Pair) -> F:
        """Return the influence (bins,) of each bin on the difference of J."""
        (first, spread_first), (second, spread_second) = map(totals.gradient, pair)
        own = first * self.columns[:, pair[0]] - second * self.columns[:, pair[1]]
        return np.asarray(own + (spread_first - spread_second) * self.columns[:, -2])

    def automatic_block(self, totals: _Totals, pair: Pair) -> int:
        """Return twice the automatic length of blocks [bins]; all bins if the recording is too short to choose one."""
        influence = self.influence(totals, pair)
        if len(influence) < MIN_BINS:
            return len(influence)
        if float(np.ptp(influence)) == 0.0:
            return 1
        return min(len(influence), 2 * block_length(influence, self.runs))

    @property
    def runs(self) -> I:
        """The whole recording as one run: blocks may span a gap, because neighbours beyond it depend on each other."""
        return np.array([[0, len(self.columns)]], dtype=np.int64)


def _block_lengths(binned: Sequence[_BinnedErrors], automatic: I) -> list[list[int]]:
    """Return lengths of blocks [bins] to try, one for each recording: the automatic ones, then parts of recordings."""
    counts = [len(b.columns) for b in binned]
    longest = automatic.max(axis=1)
    lengths = [
        [
            int(np.clip(length, n // MAX_BLOCKS + 1, n // min(LARGE_BLOCKS)))
            for n, length in zip(counts, longest, strict=True)
        ]
    ]
    return lengths + [[n // blocks for n in counts] for blocks in LARGE_BLOCKS]


def _errors(
    binned: Sequence[_BinnedErrors],
    lengths: Sequence[int],
    totals: _Totals,
    pairs: Sequence[Pair],
    random: np.random.Generator,
) -> list[tuple[float, float]]:
    """Return the standard error of each pair's difference [%] and its degrees of freedom, for these block lengths."""
    sums = [_replicate(b, length, random) for b, length in zip(binned, lengths, strict=True)]
    blocks = np.array([len(b.columns) / length for b, length in zip(binned, lengths, strict=True)])
    pooled = np.sum(sums, axis=0)
    costs = 100.0 * np.sqrt(pooled[:, :-1] / pooled[:, -1:])
    return [_error(costs, sums, blocks, totals, pair) for pair in pairs]


def _replicate(binned: _BinnedErrors, length: int, random: np.random.Generator) -> F:
    """Return sums of squared errors and of squares of the force around its mean (REPLICATES, models + 1), resampled."""
    sums = resample_sums(binned.columns, binned.runs, length, REPLICATES, random)
    spread = np.maximum(sums[:, -2] - sums[:, -3] ** 2 / sums[:, -1], MIN_SPREAD * binned.spread)
    scale = binned.columns[:, -1].sum() / sums[:, -1]
    return np.asarray(np.column_stack([sums[:, :-3], spread]) * scale[:, None])


def _error(costs: F, sums: Sequence[F], blocks: F, totals: _Totals, pair: Pair) -> tuple[float, float]:
    (first, spread_first), (second, spread_second) = map(totals.gradient, pair)
    parts = [first * s[:, pair[0]] - second * s[:, pair[1]] + (spread_first - spread_second) * s[:, -1] for s in sums]
    own = np.array([float(part.var()) for part in parts])  # variance that each recording contributes
    corrected = own * blocks / (blocks - 1.0)
    if corrected.sum() <= 0.0:
        return 0.0, float(blocks.sum())
    freedom = corrected.sum() ** 2 / float((corrected**2 / (blocks - 1.0)).sum())
    difference = costs[:, pair[0]] - costs[:, pair[1]]
    return float(np.sqrt(difference.var() * corrected.sum() / own.sum())), float(freedom)


def _p_value(value: float, error: float, freedom: float) -> float:
    if error == 0.0:
        return 1.0 if value == 0.0 else 0.0
    return float(2.0 * student.sf(abs(value) / error, freedom))


def all_pairs(models: Sequence[int]) -> list[Pair]:
    """Return every pair of models once, in order."""
    return list(combinations(models, 2))
