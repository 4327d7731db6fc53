"""Correlated values: memory and gaps, and the error of their sum against processes of known variance."""

from __future__ import annotations

import numpy as np
import pytest
from residual_series import coloured, single_run

from ces_identify.limits import ErrorLimits
from ces_identify.numerics.correlation import (
    SumError,
    add_errors,
    autocorrelation,
    covariance,
    estimate_sum_error,
    find_runs,
    longest_memory,
    memory,
)


def remembered(x):
    most = longest_memory(len(x), single_run(len(x)))
    return memory(autocorrelation(x, single_run(len(x)), most + 5), len(x), most)


def slow_covariance(x, y, runs, most):
    sums, pairs = np.zeros(most + 1), np.zeros(most + 1)
    for start, stop in runs:
        for k in range(start, stop):
            for lag in range(most + 1):
                if k + lag < stop:
                    sums[lag] += x[k] * y[k + lag]
                    pairs[lag] += 1
    return sums, pairs


def test_no_product_spans_a_gap():
    random = np.random.default_rng(1)
    x, y = random.normal(size=(2, 60))
    runs = np.array([[0, 25], [25, 28], [28, 60]])
    for ours, slow in zip(covariance(x, y, runs, 10), slow_covariance(x, y, runs, 10), strict=True):
        np.testing.assert_allclose(ours, slow, atol=1e-12)
    assert not np.allclose(covariance(x, y, runs, 10)[0], covariance(x, y, single_run(60), 10)[0])


def test_runs_end_at_gaps_and_at_ticks_left_out():
    mask = np.array([0, 1, 1, 0, 1, 1, 1, 1, 0, 0, 1], bool)
    segments = np.array([[0, 6], [6, 11]])
    np.testing.assert_array_equal(find_runs(mask, segments), [[0, 2], [2, 4], [4, 6], [6, 7]])


def test_memory_grows_with_the_pole_and_is_nothing_for_white_noise():
    lengths = [remembered(coloured(5000, pole, 3)) for pole in (0.0, 0.5, 0.9, 0.97)]
    assert lengths[0] <= 1
    assert lengths == sorted(lengths)
    assert 20 < lengths[2] < 60  # 0.9^k falls below 2 sqrt(log10(n) / n) = 0.054 at k = 28


def test_memory_of_what_never_forgets_is_bounded():
    assert remembered(np.sin(np.arange(4000) / 10.0)) == round(2 * np.sqrt(4000))


def process(seed, share, n=2_000):
    """A first-order process with a correlation time of `share` of its length; white noise for share 0."""
    return coloured(n, np.exp(-1.0 / (share * n)) if share else 0.0, seed)


@pytest.mark.parametrize("seconds", [10.0, 30.0, 100.0])
def test_the_error_is_right_for_the_slowest_process_allowed(seconds):
    share = max(ErrorLimits.SLOWEST_S / seconds, ErrorLimits.MIN_SHARE)
    runs = [process(seed, share) for seed in range(300)]
    estimated = np.mean([estimate_sum_error(x, seconds).variance for x in runs])
    assert 0.8 < estimated / np.var([x.sum() for x in runs]) < 2.5  # the alarm makes it larger
    covered = [abs(x.sum()) <= estimate_sum_error(x, seconds).half_width(0.95) for x in runs]
    assert np.mean(covered) >= 0.93


@pytest.mark.parametrize("share", [0.0, 0.005, 0.02])
def test_the_error_is_never_too_small_for_faster_ones(share):
    covered = [
        abs(x.sum()) <= estimate_sum_error(x, 60.0).half_width(0.95) for x in (process(s, share) for s in range(200))
    ]
    assert np.mean(covered) >= 0.95


def test_errors_of_recordings_add():
    one = SumError(4.0, 4.0, 1.0, 8.0)
    both = add_errors([one, one])
    assert (both.variance, both.freedom, both.fast, both.fast_freedom) == (8.0, 8.0, 2.0, 16.0)
    lop_sided = add_errors([one, SumError(400.0, 4.0, 1.0, 8.0)])
    assert 4.0 < lop_sided.freedom < 4.2
    nothing = SumError(0.0, 4.0, 0.0, 4.0)
    assert nothing.p_value(0.0) == 1.0 and nothing.p_value(1.0) == 0.0 and add_errors([nothing]).variance == 0.0


def test_a_trend_raises_the_alarm():
    noise = process(1, 0.0)
    trend = noise + np.linspace(-3.0, 3.0, len(noise))
    plain, alarmed = (estimate_sum_error(x, 60.0) for x in (noise, trend))
    assert alarmed.freedom < plain.freedom and alarmed.variance > 20.0 * plain.variance
