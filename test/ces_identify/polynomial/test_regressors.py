from dataclasses import replace
from pathlib import Path

import pytest

from ces_identify.numerics.search import THESIS
from ces_identify.polynomial.candidate_rules import MAX_CANDIDATES
from ces_identify.polynomial.rules_file import built_in_rules, load_rules, parse_rules
from ces_observer.errors import CesError
from ces_observer.structures.constructed_inputs import Lag
from ces_observer.structures.polynomial import Factor

PUBLISHED = sorted((Path(__file__).resolve().parents[3] / "config" / "thesis").glob("*.yaml"))

SMALL = {
    "force": {"lags": [1, 3]},
    "speed": {"lags": [0, 2], "powers": [0.0, 0.5], "forms": ["signed", "magnitude"]},
    "current": {"lags": [4], "powers": [1], "forms": ["magnitude"]},
    "products": [[], ["speed"], ["force", "speed", "current"]],
}


def test_the_count_is_the_number_of_candidates_and_they_differ():
    rules = parse_rules(SMALL, "test")
    candidates = rules.candidates()
    assert rules.count() == len(candidates) == len(set(candidates)) == 1 + 6 + 2 * 6
    assert all(sum(f.signal == "force" for f in t.factors) <= 1 for t in candidates)


def test_built_in_rules_are_usable_and_within_the_limit():
    rules = load_rules(None)
    assert 50 < rules.count() <= MAX_CANDIDATES
    for rate_Hz in (200.0, 1000.0, 3000.0):
        candidates = rules.at_rate(rate_Hz).candidates()
        assert len(candidates) == len(set(candidates)) == rules.count()
    assert {s for p in rules.products for s in p} == {"force", "speed", "valve", "position"}
    assert "products" in built_in_rules()


def test_the_built_in_rules_find_the_lag_of_the_current_and_go_without_it():
    rules = load_rules(None)
    assert rules.open_lags == ("valve",)
    settled = rules.with_time_constant("valve", 0.02)
    assert settled.open_lags == ()
    assert {f.definition for t in settled.at_rate(1000.0).candidates() for f in t.factors} == {
        None,
        Lag("valve", "current", 0.02),
    }
    bare = rules.without_signal("current")
    assert {s for p in bare.products for s in p} == {"force", "speed", "position"}
    assert (bare.constructed, bare.open_lags) == ({}, ())


TIMED = {
    "force": {"lags": [1, 2], "speed": {"lags_ms": [4]}},
    "speed": {"lags_ms": [0, 1, 3, 8.4]},
    "position": {"lags": [0, 3]},
    "products": [["speed"], ["position"], ["force", "speed"]],
}


@pytest.mark.parametrize(
    ("rate_Hz", "lags", "beside"), [(200.0, [0, 1, 2], 1), (1000.0, [0, 1, 3, 8], 4), (3000.0, [0, 3, 9, 25], 12)]
)
def test_lags_in_milliseconds_are_the_nearest_ticks_each_once(rate_Hz, lags, beside):
    rules = parse_rules(TIMED, "test").at_rate(rate_Hz)
    terms = rules.candidates()
    assert rules.count() == len(terms) == len(set(terms)) == len(lags) + 2 + 2
    assert [t.inputs[0].lag for t in terms if t.inputs[0].signal == "speed" and not t.output_lag] == lags
    assert [t.inputs[0].lag for t in terms if t.inputs[0].signal == "position"] == [0, 3]
    assert [(t.output_lag, t.inputs[0].lag) for t in terms if t.output_lag] == [(1, beside), (2, beside)]
    assert rules.at_rate(123.0) == rules


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"valve": {}}, "unknown key 'valve'"),
        ({"force": {"lags": [0]}}, "force: lags has 0; expected whole numbers from 1 on"),
        ({"speed": {}}, "speed: expected a list of lags"),
        ({"speed": {"lags_ms": []}}, r"lags_ms is \[\]; expected a list"),
        ({"speed": {"lags_ms": [200.5]}}, r"lags_ms\[0\] is 200.5; expected a number from 0 to 200"),
        ({"speed": {"lags_ms": [0], "lags": [0]}}, r"speed: expected a list of lags, in ticks \(lags\) or"),
        ({"force": {"lags_ms": [1]}}, r"force: unknown key 'lags_ms'"),
        ({"products": []}, "products"),
        (
            {"products": [["current", "current"]]},
            "current 2 times, but its rule has 1 lags; add lags or a rule 'again'",
        ),
        (
            {"force": {"lags": [1], "speed": {"lags": [0]}}, "products": [["force", "speed", "speed"]]},
            "speed 2 times, but its rule has 1 lags",
        ),
        ({"products": [["force", "force"]]}, "expected force once at most"),
        ({"products": [["temperature"]]}, "expected signals among force, speed, current"),
        ({"speed": {"lags": [0], "again": {"lags": [-1]}}}, r"speed: again: lags\[0\] is -1; expected a whole number"),
        ({"force": {"lags": [1], "again": {"lags": [2]}}}, "force: unknown key 'again'; expected one of lags"),
        ({"initial": [["speed"]]}, r"initial\[0\]\[0\] is 'speed'; expected a factor such as {signal: speed"),
        ({"initial": [[{"lag": 1}]]}, r"initial\[0\]\[0\]: key 'signal' is missing"),
        ({"initial": [[{"signal": "heat"}]]}, r"initial\[0\]\[0\]: signal is 'heat'; expected one of force, speed"),
        ({"initial": [[{"signal": "speed", "power": 0, "form": "magnitude"}]]}, "power 0 is 1; leave the factor out"),
        ({"initial": [[{"signal": "force"}]]}, "lag is 0; expected a whole number from 1"),
        ({"initial": [[{"signal": "force", "lag": 1, "power": 2}]]}, "force has power or form; expected its lag alone"),
        ({"initial": [[{"signal": "force", "lag": 1}, {"signal": "force", "lag": 2}]]}, "expected at most one"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(CesError, match=message):
        parse_rules({**SMALL, **change}, "rules.yaml")


SPEED, SIZE = {"lags": [0, 1, 2, 3], "powers": [0.2, 1.0], "forms": ["magnitude"]}, Factor("speed", 0, 0.2, False)
SIGN = {"lags": [0, 3], "powers": [0], "forms": ["signed"]}


def test_a_signal_named_twice_has_two_lags():
    rules = parse_rules({"speed": {"lags": [0, 1, 2]}, "products": [["speed", "speed"]]}, "test")
    assert rules.count() == 3
    assert [tuple(f.lag for f in t.factors) for t in rules.candidates()] == [(0, 1), (0, 2), (1, 2)]
    thrice = parse_rules({"speed": {"lags": [0, 1, 2]}, "products": [["speed"] * 3]}, "test")
    assert [tuple(f.lag for f in t.factors) for t in thrice.candidates()] == [(0, 1, 2)]


def test_the_second_factor_of_a_signal_may_have_a_rule_of_its_own():
    block = {
        "force": {"lags": [1]},
        "current": {"lags": [1], "forms": ["magnitude"]},
        "speed": {**SPEED, "again": SIGN},
        "products": [["force", "current", "speed", "speed"]],
    }
    terms = parse_rules(block, "test").candidates()
    assert len(terms) == len(set(terms)) == (4 * 2) * 2
    assert {t.factors[:2] for t in terms} == {(Factor("force", 1), Factor("current", 1, 1.0, False))}
    inputs = {t.factors[2:] for t in terms}
    assert (replace(SIZE, lag=2), Factor("speed", 3, 0.0)) in inputs
    # |v|^0.2 sign(v) of one lag is one factor
    assert (Factor("speed", 3, 0.2),) in inputs
    assert all(len(factors) == 2 for factors in inputs if factors[0].lag not in (0, 3))


def test_lags_in_milliseconds_become_ticks_in_the_rule_again():
    again = {"lags_ms": [0, 8], "powers": [0], "forms": ["signed"]}
    rules = parse_rules({"speed": {"lags_ms": [4], "again": again}, "products": [["speed", "speed"]]}, "test")
    assert [tuple(f.lag for f in t.factors) for t in rules.at_rate(500.0).candidates()] == [(2, 0), (2, 4)]


def test_initial_terms_are_the_first_candidates():
    sized = [{"signal": "current", "lag": 4, "form": "magnitude"}, {"signal": "speed", "power": 0.4}]
    twice = [{"signal": "speed", "power": 0.5, "form": "magnitude"}, {"signal": "speed", "power": 0}]
    rules = parse_rules({**SMALL, "initial": [sized, [{"signal": "force", "lag": 3}], twice]}, "test")
    first = rules.candidates()[:3]
    assert first == rules.initial_terms()
    assert first[0].factors == (Factor("current", 4, 1.0, False), Factor("speed", 0, 0.4))
    assert (first[1].output_lag, first[2].factors) == (3, (Factor("speed", 0, 0.5),))
    # the last is among the products, too
    assert len(rules.candidates()) == rules.count() - 1 == len(parse_rules(SMALL, "test").candidates()) + 2
    assert rules.without_signal("current").initial_terms() == first[1:]
    assert parse_rules({"initial": [sized]}, "test").candidates() == first[:1]


def test_initial_terms_may_use_constructed_inputs():
    valve = {"valve": {"kind": "lag", "of": "current", "time_constant_s": "auto"}}
    rules = parse_rules({"constructed": valve, "initial": [[{"signal": "valve"}]]}, "test")
    assert rules.with_time_constant("valve", 0.02).candidates()[0].factors == (
        Factor("valve", 0, definition=Lag("valve", "current", 0.02)),
    )
    assert rules.without_signal("current").initial_terms() == ()


def test_the_candidates_of_the_thesis_include_its_published_regressors():
    candidates = set(load_rules(None, THESIS).candidates())
    published = [term for path in PUBLISHED for term in load_rules(path).initial_terms()]
    assert [len(load_rules(path).initial_terms()) for path in PUBLISHED] == [9, 7, 5]
    assert {
        term for term in published if frozenset(term.factors) not in {frozenset(c.factors) for c in candidates}
    } == set()
    assert all(sum(f.signal == "force" for f in term.factors) <= 1 for term in candidates)
    assert {f.lag for term in candidates for f in term.factors} == {0, 1, 2, 3}
    powers = {f.power for term in candidates for f in term.factors if f.signal == "speed"}
    assert powers == {0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2}
