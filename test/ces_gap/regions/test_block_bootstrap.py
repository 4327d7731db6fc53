import numpy as np
import pytest
from gap_traces import ar_noise
from scipy.stats import gamma, norm

from ces_gap.regions.locate import (
    block_s,
    effective_blocks,
    normal_scores,
    p_value_of_largest,
    q_values,
    resampled_sums,
    scattered_sums,
    t_interval,
)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_bootstrap_error_of_a_mean_is_that_of_many_series(pole):
    rng = np.random.default_rng(0)
    series = [ar_noise(4000, 1.0, pole, rng) for _ in range(40)]
    true = np.std([s.mean() for s in series])
    errors = [(resampled_sums(s[:, None] - s.mean(), 150, 100, rng) / len(s)).std() for s in series]
    assert np.mean(errors) == pytest.approx(true, rel=0.25)


def test_single_ticks_would_give_too_small_an_error():
    """What blocks are for: with a pole of 0.9 the error of a mean is more than four times that of white noise."""
    rng = np.random.default_rng(1)
    series = ar_noise(4000, 1.0, 0.9, rng)[:, None]
    blocks, ticks = (resampled_sums(series - series.mean(), n, 200, rng).std() for n in (150, 1))
    assert blocks > 3.0 * ticks


def test_blocks_are_several_correlation_lengths_within_limits():
    rng = np.random.default_rng(2)
    white, slow = (block_s(ar_noise(10_000, 1.0, pole, rng), 0.002) for pole in (0.0, 0.95))
    assert white == 0.25
    assert 0.25 < slow < 1.0
    assert block_s(np.sin(np.arange(10_000) * 0.001), 0.002) == 1.0


def test_scattered_series_keep_their_sum_on_average_and_lose_their_place():
    rng = np.random.default_rng(3)
    series = np.zeros(3000)
    series[1000:1100] = 1.0
    members = np.zeros((3000, 2))
    members[1000:1100, 0] = members[:, 1] = 1.0
    sums = scattered_sums(series, members, 50, 2000, rng)
    assert sums[:, 1].mean() == pytest.approx(100.0, rel=0.05)
    assert sums[:, 0].mean() == pytest.approx(100.0 / 30.0, rel=0.2)


def test_effective_blocks_count_visits():
    members = np.zeros((1000, 2))
    members[:, 0] = 1.0
    members[100:110, 1] = members[500:510, 1] = 1.0
    assert effective_blocks(members, 100) == pytest.approx([10.0, 2.0])


def test_intervals_on_few_blocks_are_wide():
    low, high = t_interval(np.zeros(2), np.ones(2), np.array([2.0, 400.0]))
    assert high[1] == pytest.approx(1.97, abs=0.01)
    assert high[0] == pytest.approx(12.71 * 2**0.5, abs=0.01)
    assert low == pytest.approx(-high)


def test_scores_resolve_the_tail_of_a_skewed_null():
    rng = np.random.default_rng(4)
    draws = rng.gamma(3.0, size=(4000, 1)) - 3.0
    value = np.array([9.0])
    true = gamma.sf(12.0, 3.0)
    scored = float(norm.sf(normal_scores(value, draws, 0.0)[0][0]))
    assert scored == pytest.approx(true, rel=0.5)
    assert norm.sf(9.0 / 3.0**0.5) < 0.01 * true  # the normal distribution would have it far too rare


def test_a_null_has_at_least_the_minimum_spread():
    draws = np.random.default_rng(5).normal(size=(4000, 1))
    (one,), (half,) = (normal_scores(np.array([3.0]), draws, least)[0] for least in (0.0, 2.0))
    assert one == pytest.approx(3.0, abs=0.2)
    assert half == pytest.approx(1.5, abs=0.1)
    assert abs(normal_scores(np.zeros(1), np.zeros((5, 1)), 0.0)[0][0]) < 0.01


def test_p_value_of_the_largest_counts_over_all_regions():
    draws = np.array([[0.0, 3.0], [1.0, 0.0], [0.0, 0.0]])
    assert p_value_of_largest(np.array([2.0, 0.5]), draws) == pytest.approx(2.0 / 4.0)


def test_false_discovery_rates_by_hand():
    p = np.array([0.01, 0.04, 0.03, 0.5])
    assert q_values(norm.isf(p)) == pytest.approx([0.04, 0.16 / 3.0, 0.16 / 3.0, 0.5])
