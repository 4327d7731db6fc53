import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_data.samples import coverage, speed_current_samples

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
