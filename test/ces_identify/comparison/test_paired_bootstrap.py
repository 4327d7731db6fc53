"""The paired block bootstrap: coverage at known truth, power, pairing, and where it gives no answer."""

import numpy as np
import pytest
from made_errors import RATE_HZ, aligned, two_models
from residual_series import coloured

from ces_identify.comparison import paired_bootstrap as module
from ces_identify.comparison.paired_bootstrap import find_differences, pooled_costs
from ces_identify.preparation.cost import cost


@pytest.fixture(autouse=True)
def few_replicates(monkeypatch):
    monkeypatch.setattr(module, "REPLICATES", 300)


def share_significant(n, runs, ratio=1.0, **kind):
    found = [find_differences([aligned(two_models(n, s, ratio, **kind), s)], [(0, 1)], s)[0] for s in range(runs)]
    assert np.mean([one.enough for one in found]) > 0.8
    return np.mean([one.enough and one.p_value() < 0.05 for one in found])


@pytest.mark.parametrize("pole", [0.5, 0.98])
def test_models_of_equal_cost_are_seldom_called_different(pole):
    assert share_significant(6_000, 120, pole=pole) <= 0.06


def test_a_difference_of_a_few_percent_is_found():
    assert share_significant(15_000, 20, ratio=1.3) >= 0.8


def test_errors_that_vary_slowly_need_large_blocks(monkeypatch):
    """The automatic length alone calls equal models different several times too often."""

    def slow(seed):
        sizes = [np.exp(0.7 * coloured(8_000, 0.997, 7 * seed + i)) for i in range(2)]
        return aligned(two_models(8_000, seed, pole=0.3) * sizes, seed)

    def share():
        found = [find_differences([slow(s)], [(0, 1)], s)[0] for s in range(25)]
        return np.mean([one.p_value() < 0.05 for one in found])

    with_large = share()
    monkeypatch.setattr(module, "_block_lengths", lambda binned, automatic: [[1] * len(binned)])
    assert with_large <= 0.12
    assert share() >= with_large + 0.2


def test_blocks_are_drawn_together():
    """A large common error cancels: without pairing, the error of the difference is several times larger."""
    common = 30.0 * coloured(15_000, 0.9, 1)
    errors = np.stack([common, common + 1.5 * coloured(15_000, 0.5, 2)])
    shifted = np.stack([errors[0], np.roll(errors[1], 5_000)])
    paired, apart = (find_differences([aligned(e)], [(0, 1)])[0] for e in (errors, shifted))
    assert paired.value == pytest.approx(apart.value)
    assert 5.0 * np.diff(paired.interval(0.95)) < np.diff(apart.interval(0.95))


def test_difference_and_pooled_cost_are_those_of_the_definition():
    recordings = [aligned(two_models(5_000, s, 1.3), s, f"r{s}") for s in (1, 2)]
    whole = np.concatenate([r.measured - r.measured.mean() for r in recordings])
    expected = [cost(whole, whole - np.concatenate([r.errors[i] for r in recordings])) for i in range(2)]
    np.testing.assert_allclose(pooled_costs(recordings), expected, rtol=1e-4)
    (found,) = find_differences(recordings, [(0, 1)])
    assert found.value == pytest.approx(expected[0] - expected[1], abs=1e-3)
    low, high = found.interval(0.95)
    assert low < found.value < high


def test_the_interval_excludes_zero_exactly_if_the_test_is_significant():
    for seed in range(12):
        (found,) = find_differences([aligned(two_models(6_000, seed, 1.1), seed)], [(0, 1)])
        low, high = found.interval(0.95)
        assert (found.p_value() < 0.05) == (low > 0.0 or high < 0.0)


def test_more_pairs_share_their_draws_and_the_order_only_changes_the_sign():
    errors = np.concatenate([two_models(6_000, 1, 1.2), two_models(6_000, 2)[:1]])
    both = find_differences([aligned(errors)], [(0, 1), (1, 0), (0, 2)], 5)
    assert both[0].value == -both[1].value
    assert both[0].p_value() == pytest.approx(both[1].p_value())


def test_no_answer_for_a_few_slow_blocks():
    n = 2_000
    drifting = np.linspace(0.0, 30.0, n)
    (found,) = find_differences([aligned(np.stack([drifting, drifting[::-1].copy()]))], [(0, 1)])
    assert not found.enough
    (found,) = find_differences([aligned(two_models(100, 1))], [(0, 1)])
    assert not found.enough and found.errors == ()


def test_equal_forces_cannot_differ():
    errors = two_models(5_000, 1)[[0, 0]]
    (found,) = find_differences([aligned(errors)], [(0, 1)])
    assert (found.value, found.p_value(), found.interval(0.95)) == (0.0, 1.0, (0.0, 0.0))


def test_block_lengths_in_seconds_follow_the_correlation():
    slow, fast = (find_differences([aligned(two_models(20_000, 3, pole=p))], [(0, 1)])[0] for p in (0.995, 0.3))
    assert slow.block_s > fast.block_s > 1.0 / RATE_HZ
