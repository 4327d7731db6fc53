"""Networks and fuzzy models alike: their files, their clamped inputs, and runs brought back to new."""

import json
import math

import pytest
from trained_models import experts_model, fuzzy_model, network_model

from ces_observer.errors import ModelError
from ces_observer.model import parse_model

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
        (net, lambda m: m.update(structure="polynomial_narx"), "unknown key 'network'; known are .*terms"),
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
