"""Nested forms: a gas spring and a force offset are distinguished by significance, or are both left."""

from __future__ import annotations

import pytest
from search_examples import EFFECTS, planted

from ces_gap.effects.effect import Setting
from ces_gap.effects.library import library_effect
from ces_gap.inference.fit import Refinement, fit_alone
from ces_gap.inference.search import (
    EffectSearchResult,
    interchangeable_effects,
    loses_to_nested_form,
    min_unexplained_shares,
    order_nested_forms,
    search,
)

GAS, OFFSET = library_effect("gas_spring", "charged"), library_effect("force_offset", "constant")
OTHERS = tuple(e for e in EFFECTS if e.name == "friction")


def search_around(effect: Setting, seed: int = 5) -> EffectSearchResult:
    return search(planted(effect, seed=seed), (OFFSET, GAS, *OTHERS), Refinement(), 1)


@pytest.mark.parametrize(
    ("planted_effect", "loser"),
    [(Setting(GAS, (60.0, 0.4)), "force_offset"), (Setting(OFFSET, (60.0,)), "gas_spring")],
    ids=["gas", "offset"],
)
def test_a_visible_difference_decides_however_small_its_share(planted_effect: Setting, loser: str) -> None:
    result = search_around(planted_effect)
    assert result.best is not None and result.best.names == (planted_effect.name,)
    assert interchangeable_effects(result) == ()
    shares = min_unexplained_shares(result)
    assert shares[loser] > shares[planted_effect.name] + 0.04
    costs = {f.names[0]: f.cost for f in result.alone}
    assert abs(costs["gas_spring"] - costs["force_offset"]) < 0.05 * result.gap_energy  # a share alone does not decide


def test_an_invisible_difference_leaves_both() -> None:
    result = search_around(Setting(GAS, (6.0, 0.4)), seed=6)
    assert [set(group) for group in interchangeable_effects(result)] == [{"gas_spring", "force_offset"}]


def test_fits_that_differ_in_more_or_in_unrelated_effects_do_not_decide() -> None:
    evidence = planted(Setting(GAS, (60.0, 0.4)))
    gas, offset, friction = (fit_alone(evidence, e) for e in (GAS, OFFSET, *OTHERS))
    assert loses_to_nested_form(evidence, offset, gas) and not loses_to_nested_form(evidence, gas, offset)
    assert not loses_to_nested_form(evidence, friction, gas) and not loses_to_nested_form(evidence, gas, gas)
    assert order_nested_forms(evidence, (offset, friction, gas)) == (gas, offset, friction)
