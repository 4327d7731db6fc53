"""The refits on rides of the virtual rig: the group whose counterpart changed moves; nothing moves if nothing did."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from physical_models import RELAXATION, physical_model
from rig_rides import SLOW, identified, rig_ride

from ces_gap.augmented import AugmentedSimulation
from ces_gap.effects.effect import Composition
from ces_gap.inference.evidence import learn_baseline
from ces_gap.inference.verdict import AMBIGUOUS, NAMED
from ces_gap.inputs.prepare import prepare_recordings
from ces_gap.refit import has_moved, refit_physical_model, weigh_refits
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation


@cache
def refits_of(worn, references=True):
    simulation = identified()
    real, held_out = [rig_ride(7, worn), rig_ride(8, worn)], [rig_ride(9, worn)]
    reference = [rig_ride(1), rig_ride(2)] if references else []
    inputs = prepare_recordings(simulation, real, held_out, reference)
    return refit_physical_model(simulation, inputs, learn_baseline(inputs))


def test_a_slower_valve_moves_the_valve_lag_and_closes_the_gap():
    first = refits_of(SLOW).refits[0]
    assert first.group == "valve lag" and has_moved(first) and first.closes > 0.4
    rising = next(c for c in first.changes if c.name == "Valve lag, rising current [ms]")
    assert rising.after - rising.before == pytest.approx(11.0, abs=4.0)
    assert abs(first.control_z) < 0.3 * first.moved_z
    assert np.sum(first.block_energy) == pytest.approx(first.energy)


def test_it_agrees_with_the_cause_and_disagrees_with_another():
    verdict, says = weigh_refits(NAMED, ("valve_lag",), refits_of(SLOW))
    assert verdict == NAMED and says.startswith("the refit of the model's valve lag agrees: ")
    verdict, says = weigh_refits(NAMED, ("gas_spring",), refits_of(SLOW))
    assert verdict == AMBIGUOUS and "the model's valve lag explains more" in says


def test_nothing_moves_where_nothing_changed():
    found = refits_of("")
    assert not [refit.group for refit in found.refits if has_moved(refit)]
    assert weigh_refits(NAMED, ("friction",), found) == (NAMED, "")


def test_without_references_it_reports_but_does_not_weigh():
    found = refits_of(SLOW, references=False)
    assert found.refits and all(refit.control_z is None for refit in found.refits)
    assert weigh_refits(NAMED, ("gas_spring",), found) == (NAMED, "")


def test_it_never_fails_and_other_simulations_have_none():
    function = FunctionSimulation("f", lambda time_s, position_m, current_A: 1e3 * np.gradient(position_m, time_s))
    inputs = prepare_recordings(function, [rig_ride(7)], [rig_ride(9)], [])
    baseline = learn_baseline(inputs)
    assert refit_physical_model(function, inputs, baseline) is None
    assert refit_physical_model(AugmentedSimulation("a", identified(), Composition()), inputs, baseline) is None
    by_hand = refit_physical_model(ModelSimulation(physical_model(RELAXATION)), inputs, baseline)
    assert not by_hand.refits and "cannot be refitted" in by_hand.note


def test_what_goes_wrong_is_its_note():
    simulation = identified()
    inputs = prepare_recordings(simulation, [rig_ride(7)], [rig_ride(9)], [])
    empty = replace(inputs, held_out=tuple(replace(t, usable=np.zeros(len(t), bool)) for t in inputs.held_out))
    found = refit_physical_model(simulation, empty, learn_baseline(inputs))
    assert not found.refits and "could not be refitted" in found.note
