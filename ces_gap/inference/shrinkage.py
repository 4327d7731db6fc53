"""How far a gap shrinks on recordings the fit never saw, noise taken out, with block-bootstrap intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.explanation import Interval
from ces_gap.trace import Trace

F = NDArray[np.float64]

BLOCK_S = 0.5  # [s]
RESAMPLES = 500


@dataclass(frozen=True)
class Blocks:
    """Held-out recordings cut into blocks: `ticks` (b,) usable in each, `noise` (b,) squares [N2] expected of noise."""

    traces: tuple[Trace, ...]
    ticks: F
    noise: F
    number: tuple[NDArray[np.int64], ...]  # of each tick's block, by trace
    drawn: NDArray[np.int64]  # (RESAMPLES, b) blocks of each resample

    def energy(self, forces: Sequence[F]) -> F:
        """Return the squares [N2] of measured minus modelled force in each block (b,), noise taken out."""
        total = np.zeros(len(self.ticks))
        for trace, force, number in zip(self.traces, forces, self.number, strict=True):
            error = np.where(trace.usable, trace.force - force, 0.0)
            total += np.bincount(number, error**2, len(total))
        return np.asarray(total - self.noise)

    def rms(self, energy: F) -> tuple[float, Interval]:
        """Return the RMS [N] of an energy (b,) and its 95 % interval."""
        drawn = energy[self.drawn].sum(1) / np.maximum(self.ticks[self.drawn].sum(1), 1.0)
        low, high = np.percentile(_root(drawn), [2.5, 97.5])
        return float(_root(energy.sum() / max(float(self.ticks.sum()), 1.0))), (float(low), float(high))

    def shrink(self, before: F, after: F) -> tuple[float, Interval]:
        """Return 1 - RMS after / RMS before of two energies (b,) and its 95 % interval; 0 without a gap before."""
        low, high = np.percentile(_compute_shrink(before[self.drawn].sum(1), after[self.drawn].sum(1)), [2.5, 97.5])
        return float(_compute_shrink(before.sum(), after.sum())), (float(low), float(high))


def cut_into_blocks(traces: Sequence[Trace], seed: int, max_noise_N: float = np.inf) -> Blocks:
    """Return the blocks of some held-out recordings, with noise of no more than `max_noise_N` RMS [N] on any.

    What a recording's highest frequencies hold may be the damper's, and is no more than an upper bound of the noise.
    """
    first, number = 0, []
    for trace in traces:
        blocks = first + (trace.time_s / BLOCK_S).astype(np.int64)
        number.append(blocks)
        first = int(blocks[-1]) + 1
    ticks = sum(np.bincount(n, t.usable.astype(np.float64), first) for t, n in zip(traces, number, strict=True))
    noise = sum(
        np.bincount(n, t.usable * min(t.noise_N, max_noise_N) ** 2, first) for t, n in zip(traces, number, strict=True)
    )
    drawn = np.random.default_rng(seed).integers(0, first, (RESAMPLES, first))
    return Blocks(tuple(traces), np.asarray(ticks), np.asarray(noise), tuple(number), drawn)


def _compute_shrink(before: F | np.float64, after: F | np.float64) -> F:
    """Return 1 - sqrt(after / before), 0 where nothing was there before."""
    there = np.asarray(before) > 0.0
    return np.asarray(np.where(there, 1.0 - _root(after) / _root(np.where(there, before, 1.0)), 0.0))


def _root(energy: F | np.float64) -> F:
    return np.asarray(np.sqrt(np.maximum(energy, 0.0)))
