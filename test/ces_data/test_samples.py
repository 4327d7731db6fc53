import math

import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_data.samples import ChannelStats, channel_stats, coverage, speed_current_samples

RATE = 1000
SECOND = 1_000_000_000


def recording(position, current, times=None, current_times=None):
    times = np.arange(len(position)) / RATE if times is None else times
    channels = {"position": Channel("position", "m", np.rint(times * SECOND), position)}
    if current is not None:
        stamps = np.rint((times if current_times is None else current_times) * SECOND)
        channels["current"] = Channel("current", "A", stamps, current)
    return Recording("run", channels)


def triangle(speed=0.2, seconds=10.0, period=1.0):
    """Position of constant speed up and down."""
    t = np.arange(round(seconds * RATE)) / RATE
    return speed * np.abs((t + period / 4) % period - period / 2)


def test_time_goes_where_speed_and_current_were():
    """Constant speed up and down with half the time at each current: four cells hold nearly a quarter each."""
    current = np.where(np.arange(10_000) < 5000, 0.3, 0.7)
    result = coverage([recording(triangle(), current)], speed_cells=4, current_cells=2)
    assert result.duration_s == pytest.approx(10.0, abs=0.01)
    assert result.share.sum() == pytest.approx(1.0)
    assert result.speed_edges[[0, -1]] == pytest.approx([-0.2, 0.2], rel=1e-6)
    np.testing.assert_allclose(result.share[:, [0, -1]], 0.25, atol=0.02)


def test_speed_is_that_of_a_sine():
    t = np.arange(20_000) / RATE
    speed, _, _ = speed_current_samples(recording(0.01 * np.sin(2 * np.pi * 2 * t), np.ones_like(t)))
    np.testing.assert_allclose(speed[50:-50], (0.04 * np.pi * np.cos(4 * np.pi * t))[50:-50], atol=0.002)


def test_no_speed_across_a_gap():
    """A jump of the position over a pause of 5 s is no motion."""
    t = np.concatenate([np.arange(2000), 7000 + np.arange(2000)]) / RATE
    position = np.where(t < 3, 0.0, 0.05) + 1e-6 * np.sin(t)
    speed, _, weight = speed_current_samples(recording(position, np.ones(4000), t))
    assert np.abs(speed).max() < 1e-4
    assert weight.sum() == pytest.approx(4.0, abs=0.01)


def test_current_is_held_and_unknown_before_its_first_sample():
    current_times = np.array([2.0, 6.0])
    result = speed_current_samples(recording(triangle(), np.array([0.3, 0.5]), current_times=current_times))
    assert result[2].sum() == pytest.approx(8.0, abs=0.01)
    assert (result[1] == 0.3).sum() == pytest.approx(4000, abs=3)


def test_constant_current_and_bad_samples():
    position = triangle()
    position[::50] = np.nan
    result = coverage([Recording("run", {"position": recording(position, None).channel("position")}, {"current": 0.4})])
    assert result.share.shape == (1, 24)
    assert result.current_edges.mean() == pytest.approx(0.4)
    assert result.share.sum() == pytest.approx(1.0)


def test_several_recordings_add_up_by_time_and_one_spike_does_not_set_the_scale():
    fast = triangle()
    fast[5000] += 1.0
    result = coverage(
        [recording(triangle(0.05, 30.0), np.zeros(30_000)), recording(fast, np.ones(10_000))], current_cells=2
    )
    np.testing.assert_allclose(result.share.sum(axis=1), [0.75, 0.25], atol=0.01)
    assert result.speed_edges[-1] < 1.0
    for count in (0, 3):
        result = coverage([recording(np.arange(count) * 1.0, np.ones(count))])
        assert np.isfinite(result.share).all() and np.isfinite(result.speed_edges).all()


MS = 1_000_000


def stats(stamps_ms, values=None):
    stamps = (np.asarray(stamps_ms, dtype=np.float64) * MS).astype(np.int64)
    return channel_stats(Channel("force", "N", stamps, np.arange(len(stamps)) if values is None else values))


def test_even_channel():
    assert stats(np.arange(0, 1001, 2)) == ChannelStats(501, 1.0, 500.0, 0.0, 0.002, 0, 0.0, 500.0)


def test_gaps_are_counted_and_kept_out_of_the_jitter():
    even = np.arange(300.0)
    even[100:] += 5.0
    even[200:] += 40.0
    result = stats(even)
    assert (result.gaps, result.jitter_s) == (2, 0.0)
    assert result.longest_s == pytest.approx(0.041)
    assert result.rate_Hz == pytest.approx(298 / 0.303)  # without the pause of 41 ms, which is rare


def test_jitter_is_the_spread_of_the_intervals():
    offsets = np.random.default_rng(1).normal(0.0, 0.1, 20_000)
    assert stats(np.arange(20_000) + offsets).jitter_s == pytest.approx(math.sqrt(2) * 1e-4, rel=0.02)


def test_values_that_are_not_finite_and_channels_without_an_interval():
    result = stats([0, 1, 2, 3], [np.nan, -2.0, np.inf, 5.0])
    assert (result.low, result.high) == (-2.0, 5.0)
    for count in (0, 1):
        result = stats(np.zeros(count))
        assert (result.count, result.duration_s, result.rate_Hz, result.gaps) == (count, 0.0, 0.0, 0)
        assert np.isnan([result.jitter_s, result.longest_s]).all() and np.isnan(result.low) == (count == 0)
