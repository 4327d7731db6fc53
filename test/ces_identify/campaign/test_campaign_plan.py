"""The key of a cell: the same while the result would be, another as soon as it would not."""

import json
from dataclasses import replace

import pytest
from campaign_parts import CAMPAIGN, RULES, made

from ces_identify.campaign.plan import jobs, load_campaign
from ces_identify.polynomial.candidates import load_rules
from ces_identify.polynomial.search_limits import THESIS
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
    text = "bags: {a: one}\nstructures: {polynomial: {method: [random, thesis], candidates: [built-in, rules.yaml]}}\n"
    assert len(set(keys(text))) == 4
    campaign = load_campaign(tmp_path / "c.yaml")
    rules = {
        (job.cell.settings["method"], job.cell.settings["candidates"]): job.rules
        for job in jobs(campaign, {path: made(1) for path in campaign.paths}, "defaults")
    }
    assert rules["random", "built-in"] == load_rules(None)
    assert rules["thesis", "built-in"] == load_rules(None, THESIS)
    assert rules["random", "rules.yaml"] == rules["thesis", "rules.yaml"] == load_rules(tmp_path / "rules.yaml")


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
