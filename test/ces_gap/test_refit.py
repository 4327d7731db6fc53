"""Refits of a model: the group whose counterpart changed moves, agreement is said, doubt changes nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hydraulic_models import hydraulic_model
from physical_models import LINEAR
from programs import ONE_KIND
from rig_rides import SLOW, identified, rig_ride

from ces_gap.augmented import AugmentedSimulation
from ces_gap.effects.effect import Composition
from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.inference.evidence import learn_baseline
from ces_gap.inference.verdict import NAMED, NO_GAP, UNKNOWN
from ces_gap.inputs.prepare import prepare_recordings
from ces_gap.refit import (
    GROUPS,
    GroupRefit,
    ModelRefits,
    QuantityChange,
    describe_refits,
    effects_of,
    find_contradiction,
    has_moved,
    refit_physical_model,
)
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation


@cache
def refits_of(worn, references=True):
    simulation = identified()
    real, held_out = [rig_ride(7, worn), rig_ride(8, worn)], [rig_ride(9, worn)]
    reference = [rig_ride(1), rig_ride(2)] if references else []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(*ONE_KIND)
        inputs = prepare_recordings(simulation, real, held_out, reference)
    return refit_physical_model(simulation, inputs, learn_baseline(inputs))


@pytest.mark.slow
def test_a_slower_valve_moves_the_valve_lag_and_closes_the_gap():
    first = refits_of(SLOW).refits[0]
    assert first.group == "valve lag" and has_moved(first) and first.closes > 0.4
    lag = next(c for c in first.changes if c.name.startswith("Valve lag"))
    assert lag.after - lag.before == pytest.approx(10.0, abs=4.0)
    assert abs(first.control_z) < 0.3 * first.moved_z
    assert np.sum(first.block_energy) == pytest.approx(first.energy)


@pytest.mark.slow
def test_it_agrees_with_the_cause_and_disagrees_with_another():
    most, says = weigh_refits(("valve_lag",), refits_of(SLOW))
    assert most is None and says.startswith("the refit of the model's valve lag agrees: ")
    most, says = weigh_refits(("gas_spring",), refits_of(SLOW))
    assert most is not None and "the model's valve lag explains more" in says


@pytest.mark.slow
def test_nothing_moves_where_nothing_changed():
    found = refits_of("")
    assert not [refit.group for refit in found.refits if has_moved(refit)]
    assert weigh_refits(("friction",), found) == (None, "")


@pytest.mark.slow
def test_without_references_it_reports_but_does_not_weigh():
    found = refits_of(SLOW, references=False)
    assert found.refits and all(refit.control_z is None for refit in found.refits)
    assert weigh_refits(("gas_spring",), found) == (None, "")


@pytest.mark.slow
def test_it_never_fails_and_other_simulations_have_none():
    function = FunctionSimulation("f", lambda time_s, position_m, current_A: 1e3 * np.gradient(position_m, time_s))
    inputs = prepare_recordings(function, [rig_ride(7)], [rig_ride(9)], [])
    baseline = learn_baseline(inputs)
    assert refit_physical_model(function, inputs, baseline) is None
    assert refit_physical_model(AugmentedSimulation("a", identified(), Composition()), inputs, baseline) is None
    by_hand = refit_physical_model(ModelSimulation(hydraulic_model(LINEAR)), inputs, baseline)
    assert by_hand.refits and not by_hand.note


@pytest.mark.slow
def test_what_goes_wrong_is_its_note():
    simulation = identified()
    inputs = prepare_recordings(simulation, [rig_ride(7)], [rig_ride(9)], [])
    empty = replace(inputs, held_out=tuple(replace(t, usable=np.zeros(len(t), bool)) for t in inputs.held_out))
    found = refit_physical_model(simulation, empty, learn_baseline(inputs))
    assert not found.refits and "could not be refitted" in found.note


EVERY_GROUP = tuple(effects_of(group) for group in GROUPS)

CHANGE = QuantityChange("Friction of the seals [N]", 12.0, 24.0)


def refit(name, energy, moved_z=9.0, error=0.02, control_z=0.4):
    blocks = tuple(energy / 10.0 + error / 10.0**0.5 * (1.0 if k % 2 else -1.0) for k in range(10))
    return GroupRefit(name, effects_of(name), moved_z, control_z, 0.5 * energy, energy, error, (CHANGE,), blocks)


def weigh_refits(effects, found, verdict=NAMED):
    return find_contradiction(effects, found), describe_refits(verdict, effects, found)


def weigh(*refits, verdict=NAMED, effects=("friction",), groups=EVERY_GROUP):
    return weigh_refits(effects, ModelRefits(refits, groups), verdict)


def test_a_group_of_the_effect_agrees_with_its_change_and_share():
    most, says = weigh(refit("friction", 0.8))
    assert most is None
    assert "friction agrees" in says and "friction of the seals 12 to 24 N" in says
    assert "9 standard errors (0 on the references)" in says and "closes 40% of the held-out gap" in says


def test_another_group_that_closes_clearly_more_makes_it_ambiguous():
    most, says = weigh(refit("valve lag", 0.8), refit("friction", 0.3))
    assert most is not None and most.group == "valve lag"
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
    most, says = weigh(other, refit("friction", 0.8))
    assert most is None and "friction agrees" in says


def test_an_effect_without_a_group_is_neither_confirmed_nor_contradicted():
    groups = tuple(effects for effects in EVERY_GROUP if "friction" not in effects)
    assert weigh(refit("valve lag", 0.8), groups=groups) == (None, "")


def test_a_group_that_could_gain_nothing_contradicts_its_effect():
    assert weigh(refit("valve lag", 0.8))[0] is not None


@pytest.mark.parametrize("verdict", [NO_GAP, UNKNOWN])
def test_where_nothing_is_named_it_says_what_moved(verdict):
    assert weigh(refit("valve lag", 0.8), verdict=verdict)[1].startswith("the model's valve lag moved: ")
    assert weigh(refit("valve lag", 0.8, moved_z=1.0), verdict=verdict)[1] == ""
    assert weigh_refits((), None, verdict) == (None, "")


def test_of_several_effects_one_group_suffices():
    both = replace(refit("friction", 0.8), energy=0.8)
    assert weigh(both, refit("valve lag", 0.3), effects=("valve_lag", "friction"))[0] is None


def test_every_group_is_moved_by_effects_that_name_it():
    assert all(EVERY_GROUP) and effects_of("elasticity") == ("backlash", "compressibility", "mount_compliance")
    assert {group for e in (*library(), *simulation_errors()) for group in e.moves} == set(GROUPS)
