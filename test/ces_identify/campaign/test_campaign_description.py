"""A campaign's file: what it makes, and one clear line for every mistake in it."""

from pathlib import Path

import pytest
from campaign_parts import CAMPAIGN, RULES

from ces_identify.campaign.plan import MAX_CELLS, CampaignError, load_campaign
from ces_identify.polynomial.search_limits import METHODS
from ces_observer.errors import CesError


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
        "anfis": {"rules": ("7x2",), "memberships": ("none",)},
    }
    assert campaign.split == 0.75
    assert load("bags: {a: one}\nvalidate: {b: two}\nstructures: {sigmoid: }\n").split == 1.0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("seed: [1, 2]", "seeds: [1]", "unknown key 'seeds'; known are bags"),
        ("seed: [1, 2]", "seed: [1, 1]", "seed: 1 is given twice"),
        ("seed: [1, 2]", "seed: []", "seed is []"),
        ("seed: [1, 2]", "rate: [auto, fast]", "rate is 'fast'; expected a number"),
        ("seed: [1, 2]", "certificate: maybe", "certificate is 'maybe'"),
        ("seed: [1, 2]", "split: 2", "split is 2; expected a number from 0.05 to 1"),
        ("terms: [2, 4]", "terms: [0]", "structures: polynomial: terms is 0"),
        ("rules.yaml", "none.yaml", "none.yaml: cannot be read: No such file or directory; expected candidate rules"),
        ("sigmoid: {units: 2}", "spline: {}", "structures: unknown key 'spline'; known are polynomial"),
        ("sigmoid: {units: 2}", "anfis: {rules: 40x2}", "structures: anfis: rules: "),
        ("limits: {time: 600}", "limits: {second: 20}", "limits: unknown key 'second'; known are time"),
        ("one: [one]", "one: []", "bags: one is []; expected a value"),
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
