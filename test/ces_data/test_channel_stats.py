import math

import numpy as np
import pytest

from ces_data.recording import Channel
from ces_data.samples import ChannelStats, channel_stats

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
    assert result.rate_Hz == pytest.approx(299 / 0.344)


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
