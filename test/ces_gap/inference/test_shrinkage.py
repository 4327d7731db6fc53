"""Shrink of the gap: unbiased without noise, with intervals that cover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shrinkage_examples import NOISE_N, F, gaps, make_blocks, plain

from ces_gap.inference.held_out import cut_into_blocks


def simulated() -> list[F]:
    return [t.simulated for t in plain()]


def halve_gap(gap: list[F]) -> list[F]:
    return [t.simulated + 0.5 * g for t, g in zip(plain(), gap, strict=True)]


def rms(gap: list[F]) -> float:
    squares = [g[t.usable] ** 2 for t, g in zip(plain(), gap, strict=True)]
    return float(np.sqrt(np.concatenate(squares).mean()))


def test_the_rms_is_that_of_the_gap_without_the_noise() -> None:
    gap = gaps(6.0, 1)  # smaller than the noise
    squares = []
    for seed in range(40):
        blocks = make_blocks(gap, seed)
        squares.append(blocks.rms(blocks.energy(simulated()))[0] ** 2)
    error = float(np.std(squares)) / np.sqrt(len(squares))
    assert np.mean(squares) == pytest.approx(rms(gap) ** 2, abs=4.0 * error)
    assert error < 0.02 * rms(gap) ** 2


def test_intervals_cover_the_rms_of_the_process_and_the_shrink() -> None:
    covers, covers_shrink, widths = [], [], []
    for seed in range(60):
        gap = gaps(20.0, seed)
        blocks = make_blocks(gap, seed)
        before = blocks.energy(simulated())
        low, high = blocks.rms(before)[1]
        covers.append(low <= 20.0 <= high)
        widths.append(high - low)
        low, high = blocks.shrink(before, blocks.energy(halve_gap(gap)))[1]
        covers_shrink.append(low <= 0.5 <= high)
    assert np.mean(covers) >= 0.82 and np.mean(covers_shrink) >= 0.85
    assert np.mean(widths) < 8.0  # not by being too wide


def test_the_shrink_is_one_less_the_ratio_of_rms() -> None:
    gap = gaps(40.0, 1)
    blocks = make_blocks(gap, 1)
    before = blocks.energy(simulated())
    shrink, (low, high) = blocks.shrink(before, blocks.energy(halve_gap(gap)))
    assert shrink == pytest.approx(0.5, abs=0.02) and low < shrink < high
    assert blocks.shrink(before, before)[0] == pytest.approx(0.0)
    worse = [t.simulated - g for t, g in zip(plain(), gap, strict=True)]
    assert blocks.shrink(before, blocks.energy(worse))[0] == pytest.approx(-1.0, abs=0.1)


def test_without_a_gap_the_rms_is_near_zero_and_never_complex() -> None:
    values = []
    for seed in range(10):
        blocks = make_blocks(gaps(0.0, 1), seed)
        value, (low, high) = blocks.rms(blocks.energy(simulated()))
        values.append(value)
        assert np.isfinite([value, low, high]).all() and 0.0 <= low <= high
    assert np.mean(values) < 0.15 * NOISE_N


def test_noise_is_no_more_than_what_an_explanation_leaves() -> None:
    gap = gaps(6.0, 1)
    noisy = [replace(t, noise_N=2.0 * NOISE_N) for t in make_blocks(gap, 1).traces]  # the damper's own high frequencies
    loud, quiet = cut_into_blocks(noisy, 1), cut_into_blocks(noisy, 1, NOISE_N)
    assert loud.rms(loud.energy(simulated()))[0] == 0.0
    assert quiet.rms(quiet.energy(simulated()))[0] == pytest.approx(rms(gap), rel=0.1)
    np.testing.assert_array_equal(cut_into_blocks(noisy, 1, 1e3).noise, loud.noise)


def test_only_usable_ticks_are_scored() -> None:
    gap = gaps(20.0, 1)
    blocks = make_blocks(gap, 1)
    assert blocks.ticks.sum() == sum(int(t.usable.sum()) for t in blocks.traces)
    spoiled = [np.where(t.usable, s, 1e9) for t, s in zip(blocks.traces, simulated(), strict=True)]
    np.testing.assert_array_equal(blocks.energy(spoiled), blocks.energy(simulated()))
    assert (blocks.ticks <= 250.0).all() and blocks.noise.sum() == pytest.approx(blocks.ticks.sum() * NOISE_N**2)


def test_the_same_seed_draws_the_same_interval() -> None:
    gap = gaps(20.0, 1)
    one, again, other = (
        cut_into_blocks(make_blocks(gap, 1).traces, 1),
        cut_into_blocks(make_blocks(gap, 1).traces, 1),
        cut_into_blocks(make_blocks(gap, 1).traces, 2),
    )
    intervals = [b.rms(b.energy(simulated()))[1] for b in (one, again, other)]
    assert intervals[0] == intervals[1] != intervals[2]
