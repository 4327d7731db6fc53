"""Candidates of constructed inputs: from a rules file, and by the short options."""

import re
from pathlib import Path

import pytest
import yaml

from ces_identify.polynomial.constructed import add_blend
from ces_identify.polynomial.rules_file import built_in_rules, load_rules, parse_rules
from ces_observer.errors import CesError
from ces_observer.structures.constructed_inputs import Frequency, Hysteresis, Lag, TriangularMembership
from ces_observer.structures.constructed_inputs import make_memberships as hats_over
from ces_observer.structures.polynomial import Factor

RULES = yaml.safe_load(
    """
    constructed:
      region: {kind: hats, of: current, at: [0.2, 0.5, 0.9]}
      look_up: {kind: hats, of: slip, at: [-0.001, 0.001]}
      slip: {kind: stop, of: position, half_width: 0.001}
      frequency: {kind: frequency, range_Hz: [1, 10]}
    force: {lags: [1], region: {lags: [8]}}
    speed: {lags: [0], powers: [1.0], forms: [signed]}
    region: {lags: [2]}
    look_up: {lags: [0]}
    slip: {lags: [0, 3], powers: [0.5, 1.0], forms: [signed]}
    frequency: {lags: [0], powers: [0.5], forms: [magnitude]}
    products: [[slip], [region, speed], [force, region], [look_up, frequency]]
    """
)
SLIP = Hysteresis("slip", "stop", "position", 0.001)


def factors(rules):
    return {f for term in rules.at_rate(1000.0).candidates() for f in term.factors}


def test_a_rules_file_may_define_inputs_and_use_them_as_signals():
    rules = parse_rules(RULES, "test")
    assert rules.count() == len(set(rules.at_rate(1000.0).candidates())) == 4 + 3 + 3 + 2
    used = factors(rules)
    assert Factor("slip", 3, 0.5, True, SLIP) in used
    assert (
        Factor("look_up_2", 0, 1.0, True, TriangularMembership("look_up_2", "slip", -0.001, 0.001, None, SLIP)) in used
    )
    assert {f.lag for f in used if f.signal.startswith("region_")} == {2, 8}
    assert {f.definition for f in used if f.signal == "frequency"} == {Frequency("frequency", 0.25, (1.0, 10.0), 1e-4)}


def test_without_a_signal_what_is_made_of_it_goes_too():
    assert set(parse_rules(RULES, "test").without_signal("current").products) == {("slip",), ("look_up", "frequency")}
    assert parse_rules(RULES, "test").without_signal("position").products == (("region", "speed"), ("force", "region"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slip": {"kind": "hat"}}, "kind is 'hat'; expected one of stop, play, lag, frequency, hats"),
        (
            {"slip": {"kind": "lag", "of": "position", "time_constant_s": "soon"}},
            "time_constant_s is 'soon'; expected a number from 0.0001",
        ),
        ({"slip": {"kind": "lag", "of": "region", "time_constant_s": "auto"}}, "of is 'region'; expected one of"),
        ({"frequency": {"kind": "frequency", "time_constant_s": "auto"}}, "time_constant_s is 'auto'"),
        ({"slip": 3}, "constructed: slip is 3; expected a mapping with kind"),
        ({"speed": {"kind": "frequency"}}, "name 'speed'"),
        (
            {"region": {"kind": "hats", "of": "current", "at": [1.0]}},
            r"at is \[1.0\]; expected 2 to 20 ascending peaks",
        ),
        ({"region": {"kind": "hats", "of": "current", "at": ["a", 0.5]}}, r"at\[0\] is 'a'; expected a number"),
        ({"region_1": {"kind": "frequency"}}, "names to be free"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(CesError, match=message):
        parse_rules({**RULES, "constructed": {**RULES["constructed"], **change}}, "rules.yaml")


def test_hats_take_lags_alone_and_names_need_definitions():
    with pytest.raises(CesError, match="region: unknown key 'powers'; expected one of lags"):
        parse_rules({**RULES, "region": {"lags": [0], "powers": [2.0]}}, "rules.yaml")
    with pytest.raises(CesError, match="unknown key 'region'"):
        parse_rules({**RULES, "constructed": {}}, "rules.yaml")
    with pytest.raises(CesError, match="constructed: expected names"):
        parse_rules({**RULES, "constructed": [1]}, "rules.yaml")


def test_what_the_built_in_rules_say_of_constructed_inputs_is_true():
    lines = built_in_rules().partition("(docs/constructed.md):\n")[2].splitlines()
    block = yaml.safe_load("\n".join(re.sub(r"}  .*", "}", line.removeprefix("# ")) for line in lines))
    built_in = yaml.safe_load(built_in_rules())
    constructed = {**built_in["constructed"], **block["constructed"]}
    rules = parse_rules({**built_in, "constructed": constructed}, "documented")
    assert set(rules.constructed) == {"valve", "hysteresis", "remanence", "frequency", "region"}


def test_a_time_constant_may_be_left_open_and_set_later_also_below_hats():
    open_ = {"valve": {"kind": "lag", "of": "current", "time_constant_s": "auto"}}
    known = {"slow": {"kind": "lag", "of": "current", "time_constant_s": 0.5}}
    hats = {"by_valve": {"kind": "hats", "of": "valve", "at": [0.2, 0.9]}}
    used = {name: {"lags": [0]} for name in ("valve", "slow", "by_valve")}
    products = [["valve"], ["slow"], ["by_valve", "speed"], ["speed"]]
    raw = {**RULES, **used, "constructed": {**RULES["constructed"], **open_, **known, **hats}, "products": products}
    rules = parse_rules(raw, "test")
    assert rules.open_lags == ("valve",)
    settled = rules.with_time_constant("valve", 0.03)
    assert settled.open_lags == ()
    assert {f.definition or f.signal for f in factors(settled)} == {
        *("speed", Lag("valve", "current", 0.03), Lag("slow", "current", 0.5)),
        *hats_over("by_valve", "valve", (0.2, 0.9), Lag("valve", "current", 0.03)),
    }
    bare = rules.without_signal("current")
    assert bare.products == (("speed",),)
    assert bare.open_lags == ()
    assert not {"valve", "slow", "by_valve"} & set(bare.constructed)


def test_the_rules_in_the_documentation_can_be_used_as_they_stand():
    text = (Path(__file__).parents[3] / "docs" / "constructed.md").read_text(encoding="utf-8")
    valve, twice, block = map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", text, re.DOTALL))
    built_in = yaml.safe_load(built_in_rules())
    assert valve == {"constructed": built_in["constructed"]}
    rules = parse_rules({**built_in, **block, "products": built_in["products"] + block["products"]}, "documented")
    assert rules.count() == load_rules(None).count() + (2 + 4) * 2
    thesis = parse_rules({"force": {"lags": [1]}, "current": {"lags": [1]}, **twice}, "documented")
    assert thesis.count() == len(thesis.candidates()) == 4 * 3 * 4


OF_CURRENT = parse_rules(
    {
        "force": {"lags": [1], "current": {"lags_ms": [0, 16]}},
        "speed": {"lags": [0]},
        "current": {"lags_ms": [0, 8]},
        "products": [["speed", "current"], ["force", "current"]],
    },
    "test",
)


def test_a_blend_gives_every_sub_model_the_terms_of_the_whole():
    plain = load_rules(None)
    valve = plain.constructed["valve"][0]
    for spec, of, base in (("valve", "valve", valve), ("current", "valve", valve), ("speed", "speed", None)):
        rules = add_blend(plain, f"{spec}:0.35,0.55")
        assert rules.count() == 3 * plain.count()
        hats = {f.definition for f in factors(rules) if isinstance(f.definition, TriangularMembership)}
        assert hats == set(hats_over(f"by_{of}", of, (0.35, 0.55), base))


def test_memberships_stand_at_the_lag_of_their_signal_beside_a_past_force():
    """No lag more than the signal has there itself keeps the proof of stability short."""
    no_current = parse_rules({"force": {"lags": [1]}, "products": [["force"]]}, "test")
    for rules, of, late in ((load_rules(None), "valve", 0), (OF_CURRENT, "current", 8), (no_current, "current", 0)):
        blended = add_blend(rules, f"{of}:0.35,0.55").at_rate(500.0)
        hats = {f for f in factors(blended) if isinstance(f.definition, TriangularMembership)}
        assert {f.lag for f in hats} == {late}
        assert {f.variable for f in hats} == {(of, late)}


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("remanence_1:1,2", "expected SIGNAL:A,B,... with a signal among position, speed, current, valve"),
        ("speed:a,2", "'speed:a,2': expected numbers after the colon"),
        ("speed:1", "expected 2 to 20 ascending"),
    ],
)
def test_a_wrong_option_is_named(spec, message):
    with pytest.raises(CesError, match=message):
        add_blend(load_rules(None), spec)


def test_asking_twice_is_refused():
    with pytest.raises(CesError, match="is defined already"):
        add_blend(add_blend(load_rules(None), "speed:0,1"), "speed:0,1")
    with pytest.raises(CesError, match="'by_speed_1:0,1': expected SIGNAL"):
        add_blend(add_blend(load_rules(None), "speed:0,1"), "by_speed_1:0,1")
