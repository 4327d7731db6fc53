"""Shrink of the gap on held-out recordings without measurement noise, with block-bootstrap intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.explanation import Interval
from ces_gap.trace import F, Trace

BLOCK_S = 0.5  # [s]
RESAMPLES = 500
MIN_SHOWN_SHARE = 0.05  # of the gap's energy


@dataclass(frozen=True)
class Blocks:
    """Held-out recordings in blocks: usable `ticks` (b,) and expected energy of the noise (b,) [N²] in each."""

    traces: tuple[Trace, ...]
    ticks: F
    noise: F
    number: tuple[NDArray[np.int64], ...]  # block of each tick, by trace
    resamples: NDArray[np.int64]  # (RESAMPLES, b) blocks of each resample

    def energy(self, forces: Sequence[F]) -> F:
        """Return the energy [N²] of measured minus modelled force in each block (b,), less that of the noise."""
        total = np.zeros(len(self.ticks))
        for trace, force, number in zip(self.traces, forces, self.number, strict=True):
            error = np.where(trace.usable, trace.force - force, 0.0)
            total += np.bincount(number, error**2, len(total))
        return np.asarray(total - self.noise)

    def rms(self, energy: F) -> tuple[float, Interval]:
        """Return the RMS [N] of an energy (b,) and its 95 % interval."""
        means = energy[self.resamples].sum(1) / np.maximum(self.ticks[self.resamples].sum(1), 1.0)
        low, high = np.percentile(_root(means), [2.5, 97.5])
        return float(_root(energy.sum() / max(float(self.ticks.sum()), 1.0))), (float(low), float(high))

    def shrink(self, before: F, after: F) -> tuple[float, Interval]:
        """Return 1 - RMS after / RMS before of two energies (b,) and its 95 % interval; 0 without a gap before.

        Resamples that happen to hold hardly any of the gap, as between rare contacts of a stop, show no shrink.
        """
        begun, ended = before[self.resamples].sum(1), after[self.resamples].sum(1)
        shown = begun > MIN_SHOWN_SHARE * before.sum()
        shrinks = _compute_shrink(begun[shown], ended[shown]) if shown.any() else np.zeros(1)
        low, high = np.percentile(shrinks, [2.5, 97.5])
        return float(_compute_shrink(before.sum(), after.sum())), (float(low), float(high))


def cut_into_blocks(traces: Sequence[Trace], seed: int, max_noise_N: float = np.inf) -> Blocks:
    """Return the blocks of held-out recordings, whose noise is limited to `max_noise_N` RMS [N].

    The noise estimated from a recording's highest frequencies is only an upper bound: the damper may contribute to it.
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
    resamples = np.random.default_rng(seed).integers(0, first, (RESAMPLES, first))
    return Blocks(tuple(traces), np.asarray(ticks), np.asarray(noise), tuple(number), resamples)


def _compute_shrink(before: F | np.float64, after: F | np.float64) -> F:
    """Return 1 - sqrt(after / before), 0 without a gap before."""
    is_gap = np.asarray(before) > 0.0
    return np.asarray(np.where(is_gap, 1.0 - _root(after) / _root(np.where(is_gap, before, 1.0)), 0.0))


def _root(energy: F | np.float64) -> F:
    return np.asarray(np.sqrt(np.maximum(energy, 0.0)))
