"""The error of a sum of correlated values: against processes of known variance, and its assumptions."""

import numpy as np
import pytest
from residual_series import coloured

from ces_identify.limits import ErrorLimits
from ces_identify.numerics.correlation import SumError, add_errors, estimate_sum_error


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
