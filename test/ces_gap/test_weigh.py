"""Agreement is said, clear disagreement makes a named verdict ambiguous, everything else changes nothing."""

from dataclasses import replace

import pytest

from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.inference.verdict import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN
from ces_gap.refit import GROUPS, GroupRefit, ModelRefits, QuantityChange, effects_of, weigh_refits

EVERY_GROUP = tuple(effects_of(group) for group in GROUPS)
CHANGE = QuantityChange("Friction of the seals [N]", 12.0, 24.0)


def refit(name, energy, moved_z=9.0, error=0.02, control_z=0.4):
    blocks = tuple(energy / 10.0 + error / 10.0**0.5 * (1.0 if k % 2 else -1.0) for k in range(10))
    return GroupRefit(name, effects_of(name), moved_z, control_z, 0.5 * energy, energy, error, (CHANGE,), blocks)


def weigh(*refits, verdict=NAMED, effects=("friction",), groups=EVERY_GROUP):
    return weigh_refits(verdict, effects, ModelRefits(refits, groups))


def test_a_group_of_the_effect_agrees_with_its_change_and_share():
    verdict, says = weigh(refit("friction", 0.8))
    assert verdict == NAMED
    assert "friction agrees" in says and "friction of the seals 12 to 24 N" in says
    assert "9 standard errors (0 on the references)" in says and "closes 40% of the held-out gap" in says


def test_another_group_that_closes_clearly_more_makes_it_ambiguous():
    verdict, says = weigh(refit("valve lag", 0.8), refit("friction", 0.3))
    assert verdict == AMBIGUOUS
    assert "valve lag explains more" in says and "friction 15%" in says


@pytest.mark.parametrize(
    "other",
    [
        refit("valve lag", 0.85),
        refit("valve lag", 0.95, error=0.6),
        refit("valve lag", 0.98, moved_z=2.0),
        refit("valve lag", 0.98, control_z=-12.0),
        refit("valve lag", 0.98, control_z=None),
    ],
    ids=["hardly more", "not beyond its error", "not moved", "moved on the references", "no control"],
)
def test_doubtful_disagreement_changes_nothing(other):
    verdict, says = weigh(other, refit("friction", 0.8))
    assert verdict == NAMED and "friction agrees" in says


def test_an_effect_without_a_group_is_neither_confirmed_nor_contradicted():
    groups = tuple(effects for effects in EVERY_GROUP if "friction" not in effects)
    assert weigh(refit("valve lag", 0.8), groups=groups) == (NAMED, "")


def test_a_group_that_could_gain_nothing_contradicts_its_effect():
    assert weigh(refit("valve lag", 0.8))[0] == AMBIGUOUS


@pytest.mark.parametrize("verdict", [NO_GAP, UNKNOWN])
def test_where_nothing_is_named_the_verdict_stays_and_it_says_what_moved(verdict):
    stayed, says = weigh(refit("valve lag", 0.8), verdict=verdict)
    assert stayed == verdict and says.startswith("the model's valve lag moved: ")
    assert weigh(refit("valve lag", 0.8, moved_z=1.0), verdict=verdict) == (verdict, "")
    assert weigh_refits(verdict, (), None) == (verdict, "")


def test_of_several_effects_one_group_suffices():
    both = replace(refit("friction", 0.8), energy=0.8)
    assert weigh(both, refit("valve lag", 0.3), effects=("valve_lag", "friction"))[0] == NAMED


def test_every_group_is_moved_by_effects_that_name_it():
    assert all(EVERY_GROUP) and effects_of("elasticity") == ("backlash", "compressibility", "mount_compliance")
    assert {group for e in (*library(), *simulation_errors()) for group in e.moves} == set(GROUPS)
