"""The compiled tracker is the observer's, bit for bit, on rough samples at any rate."""

import numpy as np
import pytest
from rough_samples import MS, rough_samples
from samplings import make_sampling

from ces_identify.numerics import speed_kernels as kernels
from ces_observer.tracker import BEYOND_STROKE, OK, OUT_OF_ORDER, OUTLIER, RESTARTED, UNSETTLED, Tracker

STATUS = {
    OK: kernels.STATUS_OK,
    OUT_OF_ORDER: kernels.STATUS_ORDER,
    OUTLIER: kernels.STATUS_OUTLIER,
    RESTARTED: kernels.STATUS_RESTART,
    UNSETTLED: kernels.STATUS_UNSETTLED,
    BEYOND_STROKE: kernels.STATUS_BEYOND,
}
MOTIONS = {"": {}, "speed": {"motion_noise": 0.02}, "acceleration": {"motion_noise": 0.05}}


def stepped(stamps, positions, motion, sampling):
    """The tracker's ticks, late ticks, and its outcome, number of ticks and time after the last one by samples."""
    tracker, ticks, late, rows = Tracker(sampling), [], [], []
    for sample in zip(stamps.tolist(), positions.tolist(), motion.tolist(), strict=True):
        status = STATUS[tracker.advance(*sample)]
        ticks += tracker.ticks
        late += tracker.late_ticks
        rows.append((status, len(ticks), tracker.ahead if status in (STATUS[OK], STATUS[UNSETTLED]) else 0.0))
    return np.array(ticks), late, np.array(rows)


def require_twins(stamps, positions, motion, sampling):
    ticks, late, rows = stepped(stamps, positions, motion, sampling)
    found = kernels.track(stamps, positions, sampling, motion)
    np.testing.assert_array_equal(found.status, rows[:, 0])
    np.testing.assert_array_equal(found.total, rows[:, 1])
    np.testing.assert_array_equal(found.ahead, rows[:, 2])
    np.testing.assert_array_equal(found.ticks, ticks)
    assert np.isfinite(ticks).all() and np.isfinite(found.likelihood)
    d = sampling.delay_ticks
    known = [(k - d, tick) for k, tick in enumerate(late) if tick is not None]
    expected = np.full((len(ticks), 2), np.nan)
    expected[[k for k, _ in known]] = [tick for _, tick in known] or np.empty((0, 2))
    expected = expected if d else ticks
    np.testing.assert_array_equal(found.late[:, 1], expected[:, 1])
    given = np.isfinite(expected[:, 1])
    np.testing.assert_array_equal(found.late[given, 0], expected[given, 0])
    return found


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("rate", [100.0, 333.0, 1000.0, 3004.8, 10_000.0])
@pytest.mark.parametrize("delay_ticks", [0, 1, 5])
def test_track_is_the_tracker(rate, motion, delay_ticks):
    """Samples of a rate, in ticks of 1 kHz; with a delay, what was known later, too."""
    stamps, positions, motions = rough_samples(round(rate) + delay_ticks, rate)
    sampling = make_sampling(outlier_m=0.004, delay_s=delay_ticks * 1e-3, motion=motion, **MOTIONS[motion])
    found = require_twins(stamps, positions, motions.get(motion, np.zeros(len(stamps))), sampling)
    assert set(found.status.tolist()) >= {0, 1, 3, 5}


@pytest.mark.parametrize("rate", [100.0, 777.0, 10_000.0])
def test_ticks_of_any_rate(rate):
    stamps, positions, _ = rough_samples(3, 1000.0, jitter=0.05)
    sampling = make_sampling(rate, 0.004, max_gap_s=0.07, noise_m=1e-6)
    found = require_twins(stamps, positions, np.zeros(len(stamps)), sampling)
    starts = np.flatnonzero(np.abs(np.diff(found.stamps_ns) - 1e9 / rate) > 1.0)
    assert 2 <= len(starts) < 30
    assert np.abs(found.ticks[:, 0]).max() < 0.1


@pytest.mark.parametrize("seed", [1, 2])
def test_after_rough_gaps_and_small_jumps(seed):
    dice = np.random.default_rng(seed)
    stamps = np.cumsum(np.where(dice.random(6000) < 0.05, dice.integers(2, 70, 6000), 1) * MS)
    stamps += dice.integers(-MS // 3, MS // 3, 6000)
    x = 0.03 * np.sin(stamps * 5e-8)
    x[dice.random(6000) < 0.05] += 0.01
    x += np.cumsum(dice.random(6000) < 0.001) * 0.003
    found = require_twins(stamps, x, np.zeros(6000), make_sampling(outlier_m=0.0008, max_gap_s=0.06, delay_s=0.003))
    assert set(found.status.tolist()) == {0, 2, 3, 4}


def test_a_mode_that_is_driven_away_restarts_in_both():
    """Nine ticks and one in turn: no fixed gains are stable then."""
    steps = np.where(np.arange(4000) % 2 == 0, 9_400_000, 620_000)
    stamps = np.cumsum(steps)
    x = 0.01 * np.sin(stamps * 2e-8) + np.random.default_rng(4).normal(0.0, 1e-6, 4000)
    found = require_twins(stamps, x, np.zeros(4000), make_sampling(noise_m=1e-7, outlier_m=0.02))
    assert np.abs(found.ticks[:, 1]).max() < 0.5
