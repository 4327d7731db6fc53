"""Networks and fuzzy models alike: their files, their clamped inputs, and runs brought back to new."""

import json
import math

import pytest
from trained_models import FUZZY, experts_model, fuzzy_model, network_model

from ces_observer.errors import ModelError
from ces_observer.model import parse_model
from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule, min_firing
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.structures.structure import OperatingRange

net, fuz = network_model, fuzzy_model
BOTH = {
    network_model: "2 sigmoid units on 5 regressors",
    fuzzy_model: "4 rules on 5 regressors",
    experts_model: "3 experts on 3 inputs",
}


@pytest.mark.parametrize("make", BOTH)
def test_inputs_are_clamped_and_it_shows(make):
    run, edge = make().make_predictor(), make().make_predictor()
    assert run.tick(0.0, 7.0, -2.0) == edge.tick(0.0, 1.0, 0.0)
    assert run.clamped
    assert not edge.clamped


@pytest.mark.parametrize("make", BOTH)
def test_reset_brings_a_run_back_to_new(make):
    run = make().make_predictor()
    inputs = [(0.01 * math.sin(k), math.cos(k), 0.5 + 0.5 * math.sin(0.1 * k)) for k in range(50)]
    first = [run.tick(*row) for row in inputs]
    assert [run.tick(*row) for row in inputs] != first
    run.reset()
    assert [run.tick(*row) for row in inputs] == first


def needles(m):
    for premise in m["fuzzy"]["premises"]:
        for bell in premise["memberships"]:
            bell.update(width=1e-6, slope=10.0)


@pytest.mark.parametrize(
    ("make", "change", "message"),
    [
        (net, lambda m: m.pop("network"), "key 'network' is missing"),
        (net, lambda m: m.update(structure="polynomial_narx"), "unknown key 'network'; expected one of .*terms"),
        (net, lambda m: m.update(structure="anfis"), "'fuzzy' is missing|unknown key 'network'"),
        (net, lambda m: m["network"].pop("constant"), "network: key 'constant' is missing"),
        (net, lambda m: m["network"].update(linear=[1.0]), "linear is .*; expected a list of 5 numbers"),
        (net, lambda m: m["network"]["units"][1]["slopes"].append(1.0), r"units\[1\]: slopes is"),
        (net, lambda m: m["network"].update(units=m["network"]["units"] * 150), "units is .*a list of 0 to 200"),
        (net, lambda m: m["network"].update(regressors=[]), "regressors is .*a list of 1 to 64"),
        (net, lambda m: m["network"]["regressors"][0].update(lag=0), r"regressors\[0\]: lag is 0; expected .* from 1"),
        (net, lambda m: m["network"]["regressors"][2].update(signal="valve"), "signal is 'valve'"),
        (fuz, lambda m: m.pop("fuzzy"), "'fuzzy' is missing|unknown key 'network'"),
        (fuz, lambda m: m["fuzzy"].pop("premises"), "fuzzy: key 'premises' is missing"),
        (fuz, lambda m: m["fuzzy"]["premises"][0].update(signal="force"), "signal is 'force'; expected one of speed"),
        (fuz, lambda m: m["fuzzy"]["rules"][2].update(memberships=[0, 2]), r"rules\[2\]: membership 2 of current"),
        (fuz, lambda m: m["fuzzy"]["rules"][2].update(memberships=[0, 0.5]), r"rules\[2\]: memberships\[1\] is 0.5"),
        (fuz, lambda m: m["fuzzy"]["rules"][2].update(memberships=[-1, 0]), r"rules\[2\]: memberships\[0\] is -1"),
        (fuz, lambda m: m["fuzzy"]["rules"][2].update(memberships=[0]), "memberships is .*a list of 2"),
        (fuz, lambda m: m["fuzzy"]["rules"][0].update(linear=[1.0]), "linear is .*a list of 5"),
        (fuz, lambda m: m["fuzzy"].update(rules=[]), "rules is .*a list of 1 to 200"),
        (fuz, needles, "no rule applies in a part of the input envelope"),
    ],
)
def test_what_is_wrong_is_named(make, change, message):
    raw = json.loads(make().to_json())
    change(raw)
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(json.dumps(raw), "m.json")
    assert str(caught.value).startswith("m.json")
    assert "\n" not in str(caught.value)


BOUNDS = {"position": (-0.1, 0.1), "speed": (-1.0, 1.0), "current": (0.0, 1.0)}


def run(fuzzy, limits=(-9e3, 9e3)):
    return fuzzy.make_predictor(OperatingRange(1000.0, BOUNDS, limits))


def test_a_bell_is_one_at_its_centre_and_a_half_a_width_away():
    bell = Bell(0.3, 0.2, 2.5)
    assert bell.at(0.3) == 1.0
    assert bell.at(0.5) == pytest.approx(0.5)
    assert bell.at(0.1) == pytest.approx(0.5)
    assert bell.at(0.7) == pytest.approx(1.0 / (1.0 + 2.0**5))


def test_force_is_the_blend_of_the_rules():
    v = Regressor("speed", 0, 0.0, 0.5)
    low, high = Bell(-0.5, 0.5, 1.0), Bell(0.5, 0.5, 1.0)
    rules = (Rule((0,), 1.0, (2.0,)), Rule((1,), -1.0, (3.0,)))
    force = run(Fuzzy((v,), 100.0, (Premise("speed", 0, (low, high)),), rules)).tick(0.0, 0.3, 0.0)
    a, b = 1 / (1 + (0.8 / 0.5) ** 2), 1 / (1 + (0.2 / 0.5) ** 2)
    assert force == pytest.approx(100.0 * (a * (1.0 + 2.0 * 0.6) + b * (-1.0 + 3.0 * 0.6)) / (a + b), rel=1e-12)


def test_one_rule_is_an_affine_model():
    rules = (Rule((0,), 0.5, (0.8, 2.0)),)
    regressors = (Regressor("force", 1, 0.0, 100.0), Regressor("speed", 0, 0.0, 1.0))
    r = run(Fuzzy(regressors, 100.0, (Premise("current", 3, (Bell(0.5, 0.1, 4.0),)),), rules))
    first = r.tick(0.0, 0.1, 0.9)
    assert first == pytest.approx(70.0)
    assert r.tick(0.0, 0.1, 0.2) == pytest.approx(70.0 + 0.8 * first)


def test_premises_look_back_by_their_lag():
    rules = (Rule((0,), 0.0, (0.0,)), Rule((1,), 1.0, (0.0,)))
    sharp = (Bell(0.0, 0.3, 8.0), Bell(1.0, 0.3, 8.0))
    r = run(Fuzzy((Regressor("speed", 0, 0.0, 1.0),), 1.0, (Premise("current", 2, sharp),), rules))
    forces = [r.tick(0.0, 0.0, current) for current in (0.0, 1.0, 1.0, 1.0)]
    assert forces == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-3)


def test_a_force_out_of_its_envelope_is_held():
    r = run(FUZZY, (-1.0, 1.0))
    assert (r.tick(0.0, 1.0, 0.5), r.held) == (1.0, True)


def test_rules_together_fire_at_least_what_is_said():
    least = min_firing(FUZZY, BOUNDS)
    for v in range(-10, 11):
        for i in range(11):
            grades = [[b.at(x) for b in p.memberships] for p, x in zip(FUZZY.premises, (v / 10, i / 10), strict=True)]
            assert sum(grades[0][r.memberships[0]] * grades[1][r.memberships[1]] for r in FUZZY.rules) >= least > 0.0


def test_the_steepest_bell_far_away_does_not_overflow():
    assert 0.0 <= Bell(1e9, 1e-6, 10.0).at(-1e6) < 1e-290
