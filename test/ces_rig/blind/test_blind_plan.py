"""The plan of a blind test: complete, balanced, a function of its seed, and in an order that tells nothing."""

from collections import Counter

import pytest

from ces_rig.blind.plan import KINDS, Levels, is_visible, list_spare_effects, plan_sample
from ces_rig.dampers.stepper import KINDS as DAMPERS
from ces_rig.errors import RigError

LEVELS = Levels(
    effects=("friction", "valve_lag", "backlash", "leakage", "inertia"),
    outside=("groove", "hum"),
    plants={"hydraulic": DAMPERS["hydraulic"].design},
)


def test_half_of_the_cases_without_an_effect_have_a_wrong_simulation():
    none = [case for case in plan_sample(LEVELS, 1, 200) if case.kind == "none"]
    assert abs(sum(case.baseline_ratio > 0.0 for case in none) - len(none) / 2) <= 0.5
    assert all(case.effects == () for case in none)


def test_a_sample_is_balanced():
    cases = plan_sample(LEVELS, 3, 100)
    assert Counter(case.kind for case in cases) == {"effect": 60, "none": 14, "outside": 12, "pair": 14}
    effects = [case for case in cases if case.kind == "effect"]
    assert set(Counter(case.effects for case in effects).values()) == {12}
    assert set(Counter(case.gap_to_noise for case in effects).values()) == {15}
    assert set(Counter(case.baseline_ratio for case in effects).values()) == {20}
    assert all(is_visible(case.effects, case.excitation) for case in cases)
    assert all(len(set(case.effects)) == 2 for case in cases if case.kind == "pair")


def test_a_plan_is_a_function_of_its_seed():
    plan = plan_sample(LEVELS, 1, 60)
    assert plan == plan_sample(LEVELS, 1, 60) != plan_sample(LEVELS, 2, 60)
    assert [case.number for case in plan] == list(range(1, 61))
    assert len({case.seed for case in plan}) == 60


def test_numbers_say_nothing_about_the_kind():
    cases = plan_sample(LEVELS, 5, 400)
    places = {kind: [case.number for case in cases if case.kind == kind] for kind in KINDS}
    means = {kind: sum(numbers) / len(numbers) for kind, numbers in places.items()}
    assert all(abs(mean - 200.5) < 45.0 for mean in means.values())  # 2.5 standard errors of the smallest kind


def test_what_may_stand_in_is_of_the_same_kind_and_visible():
    for case in plan_sample(LEVELS, 7, 60):
        others = list_spare_effects(case, LEVELS)
        assert case.effects not in others
        assert all(len(other) == len(case.effects) and is_visible(other, case.excitation) for other in others)


def test_an_effect_that_no_excitation_shows_is_refused():
    with pytest.raises(RigError, match="valve_lag cannot be seen under constant_current"):
        plan_sample(Levels(("valve_lag",), (), {}, ("effect",), excitations=("constant_current",)), 1, 3)
