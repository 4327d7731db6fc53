import pytest

from ces_identify.comparison.pair_results import adjusted_p_values, step_levels


def test_textbook_example():
    assert adjusted_p_values([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert adjusted_p_values([0.5, 0.9]) == [1.0, 1.0]
    assert adjusted_p_values([]) == step_levels([], 0.05) == []


def test_a_single_test_is_not_corrected():
    assert adjusted_p_values([0.03]) == [0.03]
    assert step_levels([0.03], 0.05) == [0.05]


@pytest.mark.parametrize(
    "p_values", [[0.01, 0.04, 0.03, 0.005], [0.2, 0.001, 0.024], [0.6, 0.7], [0.001, 0.002, 0.003]]
)
def test_level_of_each_step_agrees_with_the_adjusted_values(p_values):
    levels = step_levels(p_values, 0.05)
    assert [p < level for p, level in zip(p_values, levels, strict=True)] == [
        q < 0.05 for q in adjusted_p_values(p_values)
    ]
