"""Sums over blocks of ticks drawn at random, for block bootstraps.

Sequences are arrays (n, c) of concatenated runs; `runs` (r, 2) are the [start, stop) of each. Blocks are circular
within a run (Politis & Romano 1992), so that all ticks are equally likely, and never leave it.
"""

from __future__ import annotations

import numpy as np

from ces_identify.numerics.arrays import F, I

BATCH_BLOCKS = 2_000_000  # blocks drawn at a time


def resample_sums(columns: F, runs: I, length: int, replicates: int, random: np.random.Generator) -> F:
    """Return sums (replicates, c) of `columns` (n, c) over n / length blocks of `length` ticks each.

    A run shorter than a block is one block; the column sums of replicates then differ in their number of ticks.
    """
    blocks, weights = block_sums(columns, runs, length)
    chosen = -(-len(columns) // length)
    edges = np.cumsum(weights) / weights.sum()
    rows = max(1, BATCH_BLOCKS // chosen)
    return np.concatenate(
        [
            blocks[np.searchsorted(edges, random.random((min(rows, replicates - i), chosen)), "right")].sum(axis=1)
            for i in range(0, replicates, rows)
        ]
    )


def block_sums(columns: F, runs: I, length: int) -> tuple[F, F]:
    """Return for the block from each tick the sums (n, c) of `columns` (n, c), and its weight (n,) in the draw."""
    sums, weights = np.empty_like(columns), np.empty(len(columns))
    for start, stop in runs:
        n = min(length, int(stop - start))  # a run shorter than a block is one block
        circle = np.concatenate([columns[start:stop], columns[start : start + n]])
        before = np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(circle, axis=0)])
        sums[start:stop] = before[n : n + stop - start] - before[: stop - start]
        weights[start:stop] = 1.0 / n
    return sums, weights


def average_bins(x: F, runs: I, ticks: int) -> tuple[F, I]:
    """Return the means of x over whole bins of `ticks` inside the runs, and the runs in bins."""
    parts = [x[a : a + (b - a) // ticks * ticks].reshape(-1, ticks).mean(axis=1) for a, b in runs if b - a >= ticks]
    ends = np.cumsum([len(p) for p in parts])
    return np.concatenate([np.empty(0), *parts]), np.stack([np.append(0, ends[:-1])[: len(ends)], ends], axis=1)
