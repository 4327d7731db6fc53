import pytest

from ces_identify.regressors import DEFAULT_RULES, MOST_CANDIDATES, load_rules, parse_rules
from ces_observer.errors import CesError

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
    assert 100 < rules.count() <= MOST_CANDIDATES
    assert len(rules.candidates()) == rules.count()
    assert "products" in DEFAULT_RULES


def test_rules_without_a_signal():
    assert all("current" not in p for p in parse_rules(SMALL, "test").without("current").products)


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
