"""Intervals of parameters against the sealed truth: which numbers of the rig are parameters of the library, and how."""

import numpy as np
import pytest

from ces_gap.effects.library import library
from ces_rig.blind.outcome import COUNTERPARTS, list_coverage
from ces_rig.dampers.effects import WithheldEffect
from ces_rig.withheld.plants import draw_plant, physical_numbers


def build(kind, effect, intervals):
    """Return label and gap.json of one effect with reported intervals by parameter."""
    plant = draw_plant(kind, np.random.default_rng(1))
    label = {"plant": kind, "effects": [{"name": effect.name, "physical": physical_numbers(plant, effect)}]}
    parameters = {name: {"value": sum(ci) / 2, "ci95": ci} for name, ci in intervals.items()}
    return label, {"composition": {"effects": [effect.name], "parameters": {effect.name: parameters}}}


@pytest.mark.parametrize(
    ("kind", "name", "proportions", "parameter", "true"),
    [
        ("hydraulic", "force_offset", {"offset_N": -40.0}, "offset_N", -40.0),
        ("hydraulic", "inertia", {"mass_kg": 2.0}, "mass_kg", 2.0),
        ("hydraulic", "backlash", {"play_m": 3e-4}, "gap_m", 3e-4),
        ("bouc_wen", "mount_compliance", {"compliance_m_N": 4e-7, "relaxation_s": 2e-4}, "stiffness_N_m", 2.5e6),
        ("bouc_wen", "leakage", {"bypass_m_Ns": 3e-5}, "leak_m_sN", 3e-5),
        ("hydraulic", "position_delay", {"delay_s": -2e-3, "lag_share": 0.5}, "delay_s", 2e-3),
        ("bouc_wen", "bump_stop", {"stiffness_N_m": 4e4, "progression_1_m": 9.0}, "rebound_m", -0.0275),
        ("hydraulic", "current_hysteresis", {"width_A": 0.02}, "hysteresis_A", 0.02),
    ],
)
def test_the_truth_is_inside_or_not(kind, name, proportions, parameter, true):
    effect = WithheldEffect(name, 1.0, proportions)
    inside = sorted((0.99 * true, 1.01 * true))
    outside = sorted((1.01 * true, 1.02 * true))
    assert list_coverage(*build(kind, effect, {parameter: inside})) == (True,)
    assert list_coverage(*build(kind, effect, {parameter: outside})) == (False,)


def test_a_logged_current_is_inverted_and_needs_both_numbers():
    effect = WithheldEffect("current_scale", 1.0, {"gain": 0.25, "offset": 0.1})
    both = {"gain": [0.79, 0.81], "offset_A": [-0.13, -0.12]}  # 1 / 1.25, and -0.1 x 1.6 A / 1.25
    assert list_coverage(*build("bouc_wen", effect, both)) == (True, True)
    assert list_coverage(*build("bouc_wen", effect, {"gain": [0.7, 0.9]})) == ()


def test_other_laws_and_effects_that_were_not_found_are_not_counted():
    late = WithheldEffect("position_delay", 1.0, {"delay_s": 2e-3, "lag_share": 0.5})
    assert list_coverage(*build("hydraulic", late, {"delay_s": [-1.0, 1.0]})) == ()
    label, gap = build("hydraulic", WithheldEffect("inertia", 1.0, {"mass_kg": 2.0}), {"mass_kg": [1.0, 3.0]})
    gap["composition"]["parameters"]["inertia"]["mass_kg"]["ci95"] = [None, None]
    assert list_coverage(label, gap) == ()
    gap["composition"]["parameters"] = {"friction": {"coulomb_N": {"value": 1.0, "ci95": [0.0, 2.0]}}}
    assert list_coverage(label, gap) == ()


def test_the_table_names_parameters_that_exist():
    known = {(form.name, parameter.name) for form in library() for parameter in form.parameters}
    assert set(COUNTERPARTS) <= known
