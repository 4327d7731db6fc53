"""A campaign's file: its cells, their keys, one clear line for every mistake in it; the front of its results."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from campaign_parts import CAMPAIGN, RULES, made
from hypothesis import given
from hypothesis import strategies as st

from ces_identify.campaign.cells import front, is_proved, recommend_model
from ces_identify.campaign.plan import MAX_CELLS, CampaignError, jobs, load_campaign
from ces_identify.jobs import DONE, FAILED
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics.search import METHODS, THESIS
from ces_identify.polynomial.rules_file import load_rules
from ces_observer.errors import CesError

SMALL = "bags: {a: one}\nvalidate: {b: two}\nstructures: {polynomial: {candidates: rules.yaml}}\n"


@pytest.fixture
def keys(tmp_path):
    def keys(text=SMALL, rules=RULES, first=1, second=2, described="defaults"):
        (tmp_path / "rules.yaml").write_text(rules)
        (tmp_path / "c.yaml").write_text(text)
        campaign = load_campaign(tmp_path / "c.yaml")
        seeds = {path: first if path.name == "one" else second for path in campaign.paths}
        return [job.key for job in jobs(campaign, {path: made(seed) for path, seed in seeds.items()}, described)]

    return keys


@pytest.mark.parametrize(
    "text",
    [
        SMALL.replace("{a: one}", "{renamed: [one]}"),
        SMALL + "limits: {threads: 2}\n",
        SMALL + "seed: [1]\nrate: auto\n",
        SMALL.replace("candidates", "terms: [15, 20], candidates"),
    ],
)
def test_names_threads_defaults_and_further_cells_leave_the_key(keys, text):
    assert keys(text)[0] == keys()[0]


@pytest.mark.parametrize(
    "change",
    [
        {"text": SMALL + "seed: 2\n"},
        {"text": SMALL + "limits: {time: 61}\n"},
        {"text": SMALL + "limits: {starts: 2}\n"},
        {"text": SMALL + "split: 0.8\n"},
        {"text": SMALL + "certificate: false\n"},
        {"text": SMALL + "delay: 0.003\n"},
        {"text": SMALL.replace("candidates", "terms: 14, candidates")},
        {"rules": RULES.replace("[0, 2]", "[0, 3]")},
        {"first": 3},
        {"second": 3},
        {"described": "scale 0.001"},
    ],
)
def test_settings_recordings_and_signals_change_the_key(keys, change):
    assert keys(**change) != keys()


def test_the_procedure_of_the_thesis_has_its_own_built_in_candidates(tmp_path, keys):
    methods = "{method: [gauss-newton, thesis], candidates: [built-in, rules.yaml]}"
    text = f"bags: {{a: one}}\nstructures: {{polynomial: {methods}}}\n"
    assert len(set(keys(text))) == 4
    campaign = load_campaign(tmp_path / "c.yaml")
    rules = {
        (job.cell.settings["method"], job.cell.settings["candidates"]): job.rules
        for job in jobs(campaign, {path: made(1) for path in campaign.paths}, "defaults")
    }
    assert rules["gauss-newton", "built-in"] == load_rules(None)
    assert rules["thesis", "built-in"] == load_rules(None, THESIS)
    own = load_rules(tmp_path / "rules.yaml")
    assert rules["gauss-newton", "rules.yaml"] == rules["thesis", "rules.yaml"] == own


def test_keys_of_a_campaign_differ(keys):
    results = keys(CAMPAIGN)
    assert len(set(results)) == len(results) == 12


def test_the_same_recordings_under_two_names_are_refused(keys):
    with pytest.raises(CesError, match="'a' and 'again' hold the same recordings"):
        keys(SMALL.replace("{a: one}", "{a: one, again: ./one}"))


def test_a_recording_identified_on_does_not_validate(tmp_path):
    (tmp_path / "rules.yaml").write_text(RULES)
    (tmp_path / "c.yaml").write_text(CAMPAIGN)
    campaign = load_campaign(tmp_path / "c.yaml")
    one, two = campaign.paths
    made_of = {one: made(1), two: replace(made(2), sha256=json.dumps("two"))}
    by_bags = {job.cell.bags: job.validation for job in jobs(campaign, made_of, "defaults")}
    assert by_bags == {"one": (("other", two),), "both": ()}


@pytest.fixture
def load(tmp_path):
    def load(text):
        (tmp_path / "rules.yaml").write_text(RULES)
        (tmp_path / "c.yaml").write_text(text)
        return load_campaign(tmp_path / "c.yaml")

    return load


def test_cells_are_the_cross_product_seed_after_seed(load):
    cells = load(CAMPAIGN).cells()
    assert len(cells) == 2 * (2 + 1) * 2
    assert [cell.settings["seed"] for cell in cells] == [1] * 6 + [2] * 6
    assert len({(c.bags, c.structure, tuple(c.settings.items())) for c in cells}) == 12
    assert {name for cell in cells if cell.structure == "sigmoid" for name in cell.settings}.isdisjoint({"terms"})


def test_paths_are_beside_the_file(load, tmp_path):
    assert load(CAMPAIGN).paths == (tmp_path / "one", tmp_path / "two")


def test_what_is_left_out_is_as_in_identify(load):
    campaign = load("bags: {a: one}\nstructures: {polynomial: , anfis: {}}\n")
    assert campaign.structures == {
        "polynomial": {"terms": (15,), "method": (METHODS[0],), "candidates": ("built-in",)},
        "anfis": {"rules": ("7x2",)},
    }
    assert campaign.split == 0.75
    assert load("bags: {a: one}\nvalidate: {b: two}\nstructures: {sigmoid: }\n").split == 1.0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("seed: [1, 2]", "seeds: [1]", "unknown key 'seeds'; did you mean 'seed'"),
        ("seed: [1, 2]", "seed: [1, 1]", "seed: 1 is given twice"),
        ("seed: [1, 2]", "seed: []", "seed is []"),
        ("seed: [1, 2]", "rate: [auto, fast]", "rate[1] is 'fast'; expected auto or a number"),
        ("seed: [1, 2]", "certificate: maybe", "certificate is 'maybe'"),
        ("seed: [1, 2]", "delay: [0, 0.03]", "delay[1] is 0.03; expected a number from 0 to 0.02 s"),
        ("seed: [1, 2]", "delay: [[0, 0.003]]", "delay[0] is [0, 0.003]; expected a number"),
        ("seed: [1, 2]", "split: 2", "split is 2; expected a number from 0.05 to 1"),
        ("terms: [2, 4]", "terms: [0]", "structures: polynomial: terms[0] is 0"),
        ("rules.yaml", "none.yaml", "none.yaml: cannot be read: No such file or directory; expected candidate rules"),
        ("sigmoid: {units: 2}", "spline: {}", "structures: unknown key 'spline'; expected one of polynomial"),
        ("sigmoid: {units: 2}", "anfis: {rules: 40x2}", "structures: anfis: rules: "),
        ("limits: {time: 600}", "limits: {second: 20}", "limits: unknown key 'second'; expected one of time"),
        ("one: [one]", "one: []", "bags: one is []; expected a text, or a list of texts"),
        ("one: [one]", "one: [one, one]", "bags: one: 'one' is given twice"),
        ("one: [one]", "a b: [one]", "bags: name 'a b'"),
        ("  other: two", "  []", "validate is []"),
    ],
)
def test_a_mistake_is_one_line_with_file_and_key(load, tmp_path, old, new, expected):
    assert old in CAMPAIGN
    with pytest.raises(CesError) as caught:
        load(CAMPAIGN.replace(old, new))
    text = str(caught.value)
    assert expected in text
    assert str(tmp_path) in text
    assert "\n" not in text


def test_cells_are_counted_before_they_are_made(load):
    text = CAMPAIGN.replace("[1, 2]", str(list(range(400)))).replace("[2, 4]", str(list(range(1, 201))))
    with pytest.raises(CampaignError, match=f"160800 cells; at most {MAX_CELLS}"):
        load(text)


def test_the_shipped_example_is_a_campaign_of_the_sample_bags():
    campaign = load_campaign(Path(__file__).parents[3] / "config" / "campaign.yaml")
    assert len(campaign.cells()) == 48
    assert all((path / "metadata.yaml").exists() for path in campaign.paths)


def row(parameters, cost, gain=0.5, status=DONE, validation=1.0, bound_N=900.0):
    costs = [{"set": "road", "J": validation}]
    proof = {"gain": gain, "force_bound_N": bound_N}
    return {"parameters": parameters, "selection_J": cost, **proof, "status": status, "costs": costs}


def sizes(rows):
    return [r["parameters"] for r in rows]


def test_validation_costs_choose_nothing():
    rows = [row(4, 5.0, validation=0.1), row(8, 2.0, validation=90.0)]
    assert recommend_model(rows)["parameters"] == 8


def test_the_smallest_within_a_tenth_is_recommended():
    assert recommend_model([row(4, 2.3), row(6, 2.19), row(20, 2.0)])["parameters"] == 6


def test_models_without_proof_count_only_if_none_has_one():
    assert sizes(front([row(4, 1.0, bound_N=None), row(6, 2.0)])) == [6]
    assert sizes(front([row(4, 1.0, bound_N=None), row(6, 2.0, bound_N=None)])) == [4]


def test_a_proof_without_a_gain_is_a_proof():
    passive = row(4, 1.0, gain=None)
    assert is_proved(passive) and not is_proved(row(4, 1.0, gain=None, bound_N=None))
    assert sizes(front([passive, row(6, 0.9)])) == [4, 6]


def test_failed_and_diverged_cells_are_left_out():
    assert front([{"status": FAILED}, row(4, None)]) == []
    assert recommend_model([]) is None


@given(st.lists(st.tuples(st.integers(1, 30), st.floats(0.1, 100.0)), min_size=1))
def test_nothing_beats_the_front_and_the_front_beats_the_rest(points):
    rows = [row(*point) for point in points]
    best = front(rows)
    for r in rows:
        better = [b for b in best if b["parameters"] <= r["parameters"] and b["selection_J"] <= r["selection_J"]]
        assert better
        if r in best:
            assert better == [r]
    chosen = recommend_model(rows)["selection_J"]
    assert chosen <= (1.0 + ChoiceLimits.COST_TOLERANCE) * min(r["selection_J"] for r in rows)
