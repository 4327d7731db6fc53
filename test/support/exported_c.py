"""Rough samples for the estimator, and models with a delay."""

from dataclasses import replace

import numpy as np
from hydraulic_models import ENVELOPE
from tick_forms import Samples

COUNT = 2000
MS = 1_000_000


def stroke(stamps):
    t = (stamps - stamps[0]) * 1e-9
    return 0.012 * np.sin(25.0 * t) + 0.004 * np.sin(90.0 * t + 1.0)


def steady(dice, interval_ns=MS, jitter_ns=0.0):
    stamps = 10**18 + np.arange(COUNT) * interval_ns + np.rint(dice.uniform(-jitter_ns, jitter_ns, COUNT)).astype(int)
    position = stroke(stamps) + dice.normal(0, 15e-6, COUNT)
    return stamps, position, 0.5 + 0.3 * np.sin(stamps * 4e-9)


def jittered(dice):
    return steady(dice, jitter_ns=0.45 * MS)


def gapped(dice):
    stamps, _, current = jittered(dice)
    for at, gap_ms in ((400, 49), (900, 60), (1000, 5), (1300, 20_000)):
        stamps[at:] += gap_ms * MS
    kept = dice.random(COUNT) > 0.1
    return stamps[kept], stroke(stamps)[kept], current[kept]


def not_finite(dice):
    stamps, position, current = jittered(dice)
    for values in (position, current):
        values[dice.choice(COUNT, 100, replace=False)] = dice.choice([np.nan, np.inf, -np.inf], 100)
    position[:5] = np.nan
    position[1000:1080] = np.nan
    return stamps, position, current


def outliers(dice):
    stamps, position, current = jittered(dice)
    position[dice.choice(COUNT, 60, replace=False)] += 0.05
    position[700:709] -= 0.1
    position[950:960] += 0.2
    position[1150:1161] += 0.2
    position[1400:] += 0.03
    position[1800] = 1e308
    return stamps, position, current


def late(dice):
    stamps, position, current = jittered(dice)
    for at in dice.choice(np.arange(10, COUNT), 80, replace=False):
        stamps[at] = stamps[at - dice.integers(1, 9)]
    stamps[800] -= 2_000 * MS
    stamps[1400:] -= 5_000 * MS
    return stamps, position, current


def slow(dice):
    return steady(dice, interval_ns=4_100_000)


def fast(dice):
    return steady(dice, interval_ns=301_000, jitter_ns=100_000)


def wide(dice):
    stamps, position, current = jittered(dice)
    return stamps, 2.0 * position, 3.0 * (current - 0.3)


def at_rest(dice):
    stamps, position, current = steady(dice)
    position[:] = 0.0
    position[1000:] = -0.0
    return stamps, position, current


def half_ticks(dice):
    """Samples exactly between two ticks of the model that ticks every 2^20 ns, where rounding decides."""
    return steady(dice, interval_ns=2**19)


def edges(dice):
    """A clock that starts at zero, a position just not an outlier, a gap just not too long and one that is."""
    stamps, position, current = steady(dice)
    stamps -= stamps[0]
    position[:2] = [0.0, 0.004]
    stamps[1000:] += 49 * MS
    stamps[1200:] += 49 * MS + 1
    return stamps, position, current


def lost_rows(dice):
    """A fast stroke of which rows of up to 60 samples are lost, with wrong positions straight after some."""
    stamps, _, current = jittered(dice)
    position, kept, at = 6.0 * stroke(stamps), np.ones(COUNT, bool), 150
    while at < COUNT - 100:
        lost = dice.integers(1, 61)
        kept[at : at + lost] = False
        position[at + lost] += dice.choice([0.0, 0.0, 0.01, 0.05, 0.4, -0.2])
        at += lost + dice.integers(2, 60)
    return stamps[kept], position[kept], current[kept]


def ends_of_time(dice):
    stamps, position, current = steady(dice)
    first, last = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    stamps[:1000] = first + np.arange(1000) * MS
    stamps[1000:1010] = [first, last, 0, first, -1, 0, 1, last, last - 1, first]
    stamps[1400:] = last - np.arange(COUNT - 1400)[::-1] * MS
    return stamps, position, current


def all_at_once(dice):
    stamps, position, current = outliers(dice)
    stamps[600:] += 70 * MS
    stamps[1200:] -= 400 * MS
    current[dice.choice(COUNT, 50, replace=False)] = np.nan
    kept = dice.random(COUNT) > 0.05
    return stamps[kept], position[kept], 2.0 * current[kept]


INPUTS = [
    *(steady, jittered, gapped, not_finite, outliers, late, slow, fast),
    *(wide, at_rest, half_ticks, edges, lost_rows, ends_of_time, all_at_once),
]


def a_million_samples():
    """Jitter, lost rows, gaps, jumps, spikes, wild positions, and stamps that repeat, run back or leap by years."""
    dice, n = np.random.default_rng(9), 1_000_000
    intervals = dice.uniform(0.6, 1.4, n) * MS
    rows = dice.random(n) < 4e-3  # lost, mostly shorter than a gap that restarts
    intervals[rows] += dice.exponential(15.0 * MS, rows.sum())
    intervals[dice.random(n) < 0.02] = 0.2 * MS  # several samples in a tick
    stamps = 10**18 + np.cumsum(np.rint(intervals).astype(np.int64))
    position = stroke(stamps) * dice.choice([0.5, 1.0, 2.0], n // 1000).repeat(1000) + dice.normal(0, 15e-6, n)
    position += 0.03 * (np.cumsum(dice.random(n) < 2e-5) % 2)  # jumps that last
    wild = dice.random(n) < 3e-3
    position[wild] += dice.choice([0.01, -0.05, 0.3, 1e3, -1e308, np.nan, np.inf], wild.sum())
    wrong = dice.random(n) < 2e-3
    stamps[wrong] += dice.choice([0, -1, -MS, -3 * MS, 40 * MS, -60 * MS, 10**17, -(10**18)], wrong.sum())
    current = np.where(dice.random(n) < 1e-3, np.nan, 0.5 + 0.3 * np.sin(stamps * 4e-9))
    return stamps, position, current


def with_delay(model, delay_s):
    """Return a model whose estimates come late."""
    return replace(model, sampling=replace(model.sampling, delay_s=delay_s))


def motion_of(stamps, position):
    """Return a rough speed or acceleration: some are missing, as where none was recent enough."""
    motion = 40.0 * np.clip(np.nan_to_num(position), -1.0, 1.0) + 1e-9 * (stamps % 1_000_003)
    motion[stamps % 89 == 0], motion[stamps % 83 == 0] = 1e6, -1e300
    return np.where(stamps % 97 == 0, np.nan, motion)


def seeded(shape):
    return shape(np.random.default_rng(INPUTS.index(shape)))


def as_samples(model, stamps, position, current):
    """Return samples for a model: with a rough motion if it needs one."""
    motion = motion_of(stamps, position) if model.sampling.motion else np.zeros(len(stamps))
    return Samples(stamps.astype(np.int64), np.column_stack([position, current, motion]).astype(float))


def rough_samples(model):
    """Return all INPUTS in a row, each some seconds after the one before: 30,000 samples."""
    return as_samples(model, *map(np.concatenate, zip(*map(seeded, INPUTS), strict=True)))


def hostile(count, seed):
    """Return inputs that jump between and beyond the ends of their ranges, each held for random times."""
    dice, inputs = np.random.default_rng(seed), []
    for low, high in ENVELOPE.by_signal.values():
        width = high - low
        ends = dice.choice([low, high, low - 1.5 * width, high + 1.5 * width, high + 0.4 * width, 0.0], count)
        drawn = np.where(dice.random(count) < 0.7, ends, dice.uniform(low - 1.5 * width, high + 1.5 * width, count))
        new = dice.random(count) < dice.choice([0.02, 0.3, 1.0])
        inputs.append(drawn[np.maximum.accumulate(np.where(new, np.arange(count), 0))])
    return inputs
