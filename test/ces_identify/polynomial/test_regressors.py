import pytest

from ces_identify.polynomial.regressors import DEFAULT_RULES, MAX_CANDIDATES, load_rules, parse_rules
from ces_observer.errors import CesError
from ces_observer.structures.constructed_inputs import Lag

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
    assert "products" in DEFAULT_RULES


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
    ("rate_Hz", "lags", "beside"),
    [(200.0, [0, 1, 2], 1), (1000.0, [0, 1, 3, 8], 4), (3000.0, [0, 3, 9, 25], 12)],
)
def test_lags_in_milliseconds_are_the_nearest_ticks_each_once(rate_Hz, lags, beside):
    rules = parse_rules(TIMED, "test").at_rate(rate_Hz)
    terms = rules.candidates()
    assert rules.count() == len(terms) == len(set(terms)) == len(lags) + 2 + 2
    assert [t.inputs[0].lag for t in terms if t.inputs[0].signal == "speed" and not t.output_lag] == lags
    assert [t.inputs[0].lag for t in terms if t.inputs[0].signal == "position"] == [0, 3]
    assert [(t.output_lag, t.inputs[0].lag) for t in terms if t.output_lag] == [(1, beside), (2, beside)]
    assert rules.at_rate(123.0) == rules


def test_rules_without_a_signal():
    assert all("current" not in p for p in parse_rules(SMALL, "test").without_signal("current").products)


def test_an_exploding_rule_is_refused_with_its_count():
    wide = {**SMALL, "speed": {"lags": list(range(100)), "powers": [0.1 * k for k in range(1, 50)]}}
    with pytest.raises(CesError, match=r"candidate rules make 14701 terms; at most"):
        parse_rules(wide, "test").candidates()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"valve": {}}, "unknown key 'valve'"),
        ({"force": {"lags": [0]}}, r"force: lags \[0\]; expected whole numbers from 1"),
        ({"speed": {"lags": [0.5]}}, "lags"),
        ({"speed": {"lags": [0], "powers": [-1]}}, "powers"),
        ({"speed": {"lags": [0], "forms": ["odd"]}}, "forms"),
        ({"speed": {"lag": [0]}}, "unknown key 'lag'"),
        ({"speed": {}}, "lags is None; expected a list"),
        ({"speed": {"lags_ms": []}}, r"lags_ms is \[\]; expected a list"),
        ({"speed": {"lags_ms": [-1]}}, r"speed: lags_ms \[-1\]; expected numbers from 0 to 200"),
        ({"speed": {"lags_ms": [200.5]}}, r"lags_ms \[200.5\]; expected numbers from 0 to 200"),
        ({"speed": {"lags_ms": [float("nan")]}}, r"lags_ms \[nan\]; expected numbers"),
        ({"speed": {"lags_ms": ["8"]}}, r"lags_ms \['8'\]; expected numbers"),
        ({"speed": {"lags_ms": [True]}}, r"lags_ms \[True\]; expected numbers"),
        ({"speed": {"lags_ms": [0], "lags": [0]}}, r"speed: lags_ms \[0\]; expected lags alone$"),
        ({"force": {"lags_ms": [1]}}, r"force: lags_ms \[1\]; expected lags alone in ticks"),
        ({"force": {"lags": [1], "speed": {"lags_ms": [-1]}}}, r"force: speed: lags_ms \[-1\]"),
        ({"products": []}, "products"),
        ({"products": [["speed", "speed"]]}, "different signals"),
        ({"products": [["temperature"]]}, "different signals"),
    ],
)
def test_what_is_wrong_is_named(change, message):
    with pytest.raises(CesError, match=message):
        parse_rules({**SMALL, **change}, "rules.yaml")


@pytest.mark.parametrize("text", ["force: [", "- 1", "", "a: !!python/object:os.system {}"])
def test_a_broken_file_is_named(tmp_path, text):
    (tmp_path / "r.yaml").write_text(text)
    with pytest.raises(CesError, match=r"r\.yaml"):
        load_rules(tmp_path / "r.yaml")
