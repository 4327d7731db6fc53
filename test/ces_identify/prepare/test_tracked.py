"""`track` collects the ticks of the tracker: CPython and Numba agree bit for bit, whatever the samples are."""

import math

import numpy as np
import pytest
from rough_samples import MS, rough_samples
from samplings import make_sampling
from trackers import Tracker

from ces_identify.prepare.series import track
from ces_observer.reasons import REASONS
from ces_observer.tick.bank import TOTAL
from ces_observer.tick.tracker import BEYOND_STROKE, NOT_FINITE, OK, OUT_OF_ORDER, OUTLIER, RESTARTED, UNSETTLED

MOTIONS = {"": {}, "speed": {"motion_noise": 0.02}, "acceleration": {"motion_noise": 0.05}}
TAKEN = (REASONS[OK], REASONS[UNSETTLED])


def hostile_samples(seed, motion, count=8000):
    """Rough samples with stamps of other times, numbers that are none or huge, and long runs of outliers among them."""
    stamps, x, motions = rough_samples(seed, 1000.0, count)
    dice, felt = np.random.default_rng(seed), motions.get(motion, np.zeros(len(x)))
    gaps = np.cumsum(np.where(dice.random(len(x)) < 0.01, dice.integers(2, 70, len(x)), 0) * MS)
    x[dice.random(len(x)) < 0.02] += 0.008
    for values in (x, felt):
        wild = dice.choice(len(x), 60, replace=False)
        values[wild] = dice.choice([math.nan, math.inf, -math.inf, 1e308, -1e7, 0.0], 60)
    stamps += gaps
    stamps[dice.choice(len(x), 5)] = dice.integers(-(2**61), 2**61, 5)
    return stamps, x, felt if motion else np.zeros(len(x))


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize(("delay_ticks", "rate"), [(0, 1000.0), (3, 1000.0), (2, 333.0), (1, 3004.8)])
def test_track_gives_the_ticks_of_the_tracker(motion, delay_ticks, rate):
    sampling = make_sampling(rate, 0.004, delay_s=delay_ticks / rate, motion=motion, **MOTIONS[motion])
    samples = hostile_samples(round(rate) + delay_ticks, motion)
    tracker, tracked = Tracker(sampling), track(*samples[:2], sampling, samples[2])
    ticks, late, likelihood = [], [], []
    for i, sample in enumerate(zip(*(column.tolist() for column in samples), strict=True)):
        reason = tracker.advance(*sample)
        ticks += tracker.ticks
        late += tracker.late_ticks
        likelihood += [math.log(tracker.s[TOTAL])] if tracker.ticks and reason in TAKEN else []
        ahead = tracker.ahead if reason in TAKEN else 0.0
        assert (REASONS[tracked.status[i]], tracked.total[i], tracked.ahead[i]) == (reason, len(ticks), ahead)
    np.testing.assert_array_equal(tracked.ticks, ticks)
    expected = np.full((len(ticks), 2), np.nan) if delay_ticks else np.array(ticks)
    for i, tick in enumerate(late):
        if tick is not None:
            expected[i - delay_ticks] = tick
    np.testing.assert_array_equal(tracked.late, expected)
    assert tracked.likelihood == pytest.approx(np.mean(likelihood), rel=1e-12)
    outcomes = {OK, NOT_FINITE, OUT_OF_ORDER, OUTLIER, BEYOND_STROKE, RESTARTED, UNSETTLED}
    assert set(tracked.status.tolist()) == outcomes


@pytest.mark.parametrize("rate", [100.0, 777.0, 10_000.0])
def test_stamps_are_those_of_ticks_at_the_rate(rate):
    stamps, positions, _ = rough_samples(3, 1000.0, jitter=0.05)
    tracked = track(stamps, positions, make_sampling(rate, 0.004, max_gap_s=0.07, noise_m=1e-6))
    starts = np.flatnonzero(np.abs(np.diff(tracked.stamps_ns) - 1e9 / rate) > 1.0)
    assert 2 <= len(starts) < 30
    assert np.abs(tracked.ticks[:, 0]).max() < 0.1


def test_innovations_are_those_of_samples_that_have_a_prediction():
    stamps, positions, _ = rough_samples(5)
    tracked = track(stamps, positions, make_sampling(outlier_m=0.004))
    without = np.isin(tracked.status, (OUT_OF_ORDER, BEYOND_STROKE))
    assert np.isnan(tracked.innovations[without]).all()
    assert np.isfinite(tracked.innovations[~without & (tracked.status != RESTARTED)]).all()
    assert np.median(np.abs(tracked.innovations[tracked.status == OK])) < 1e-4
    assert np.abs(tracked.innovations[tracked.status == OUTLIER]).min() > 0.004


def test_a_mode_that_is_driven_away_restarts():
    """Nine ticks and one in turn: no fixed gains are stable then."""
    stamps = np.cumsum(np.where(np.arange(4000) % 2 == 0, 9_400_000, 620_000))
    x = 0.01 * np.sin(stamps * 2e-8) + np.random.default_rng(4).normal(0.0, 1e-6, 4000)
    tracked = track(stamps, x, make_sampling(noise_m=1e-7, outlier_m=0.02))
    assert np.abs(tracked.ticks[:, 1]).max() < 0.5
