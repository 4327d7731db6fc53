"""Differences of costs: false positives at known truth, power, pairing, several tests, and recordings too short."""

import numpy as np
import pytest
from made_errors import RATE_HZ, aligned, two_models
from residual_series import coloured

from ces_identify.comparison.pair_results import adjusted_p_values, find_differences, pooled_costs, step_levels
from ces_identify.prepare.cost import cost

ALPHA = 0.05
ALL = [(a, b) for a in range(4) for b in range(a + 1, 4)]


def slow_models(n, seed, slow_s, models=2):
    """Errors of equal cost whose sizes change slowly, with a correlation time of `slow_s`."""
    pole = np.exp(-1.0 / (slow_s * RATE_HZ))
    sizes = [np.exp(0.5 * coloured(n, pole, 100 * seed + i)) for i in range(models)]
    own = [coloured(n, 0.98, 100 * seed + 50 + i) for i in range(models)]
    return coloured(n, 0.98, 100 * seed + 99) + np.array(sizes) * own


def find(errors, seed=0):
    return find_differences([aligned(errors, seed)], [(0, 1)])[0]


@pytest.mark.parametrize("pole", [0.5, 0.98])
def test_models_of_equal_cost_are_seldom_called_different(pole):
    false = [find(two_models(15_000, s, pole=pole), s).p_value() < ALPHA for s in range(60)]
    assert np.mean(false) <= 0.05


@pytest.mark.parametrize(("seconds", "slow_s"), [(10, 1.0), (30, 3.0)])
def test_slow_changes_do_not_make_equal_models_different(seconds, slow_s):
    found = [find(slow_models(500 * seconds, s, slow_s), s) for s in range(80)]
    assert np.mean([one.p_value() < ALPHA for one in found]) <= 0.06
    assert np.mean([one.error.fast_p_value(one.value) < ALPHA for one in found]) >= 0.06  # without the bound


def test_several_recordings_and_several_models_of_equal_cost():
    def any_false(seed):
        recordings = [aligned(slow_models(5_000, 10 * seed + i, 2.0, 4), i, f"r{i}") for i in range(3)]
        return min(adjusted_p_values([one.p_value() for one in find_differences(recordings, ALL)])) < ALPHA

    assert np.mean([any_false(seed) for seed in range(34)]) <= 0.06


def test_a_difference_of_a_few_percent_is_found_in_a_minute():
    assert np.mean([find(two_models(30_000, s, 1.2), s).p_value() < ALPHA for s in range(20)]) >= 0.8


def test_too_short_is_what_only_the_bound_on_slow_changes_forbids():
    found = [find(two_models(5_000, s, 1.3, pole=0.98), s) for s in range(60)]  # 10 s
    short = [one for one in found if one.is_too_short(ALPHA)]
    assert 10 <= len(short) <= 50
    assert all(one.p_value() >= ALPHA > one.error.fast_p_value(one.value) for one in short)
    assert all(one.p_value() < ALPHA or one.error.fast_p_value(one.value) >= ALPHA for one in found if one not in short)


def test_common_errors_cancel():
    """A large common error cancels: without pairing, the error of the difference is several times larger."""
    common = 30.0 * coloured(15_000, 0.9, 1)
    errors = np.stack([common, common + 1.5 * coloured(15_000, 0.5, 2)])
    shifted = np.stack([errors[0], np.roll(errors[1], 5_000)])
    paired, apart = find(errors), find(shifted)
    assert paired.value == pytest.approx(apart.value)
    assert 4.0 * np.diff(paired.interval(0.95)) < np.diff(apart.interval(0.95))


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
        found = find(two_models(20_000, seed, 1.2), seed)
        low, high = found.interval(0.95)
        assert (found.p_value() < ALPHA) == (low > 0.0 or high < 0.0)


def test_the_order_only_changes_the_sign():
    first, second = find_differences([aligned(two_models(6_000, 1, 1.2))], [(0, 1), (1, 0)])
    assert first.value == -second.value and first.p_value() == pytest.approx(second.p_value())


def test_a_drift_is_no_difference():
    drifting = np.linspace(0.0, 30.0, 30_000)
    assert find(np.stack([drifting, drifting[::-1] ** 1.02])).p_value() > 0.2


def test_no_answer_for_a_moment():
    found = find(two_models(300, 1))
    assert found.error is None and found.is_too_short(ALPHA)
    assert find(two_models(2_500, 1)).is_too_short(ALPHA)  # 5 s


def test_equal_forces_cannot_differ():
    found = find(two_models(5_000, 1)[[0, 0]])
    assert (found.value, found.p_value(), found.interval(0.95)) == (0.0, 1.0, (0.0, 0.0))
    assert not found.is_too_short(ALPHA)


def test_p_values_of_several_tests_are_adjusted_as_in_the_textbook() -> None:
    assert adjusted_p_values([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert adjusted_p_values([0.5, 0.9]) == [1.0, 1.0]
    assert adjusted_p_values([0.03]) == [0.03] and step_levels([0.03], 0.05) == [0.05]
    assert adjusted_p_values([]) == step_levels([], 0.05) == []


@pytest.mark.parametrize(
    "p_values", [[0.01, 0.04, 0.03, 0.005], [0.2, 0.001, 0.024], [0.6, 0.7], [0.001, 0.002, 0.003]]
)
def test_level_of_each_step_agrees_with_the_adjusted_values(p_values):
    levels = step_levels(p_values, 0.05)
    assert [p < level for p, level in zip(p_values, levels, strict=True)] == [
        q < 0.05 for q in adjusted_p_values(p_values)
    ]
