"""The page of a campaign: names, links, charts, sorting, and what a running campaign shows."""

import pytest
from browser import find_faults, open_page

from ces_identify.campaign.page import PAGE, write_campaign_page
from ces_identify.campaign.rows import CampaignRows, CellNames, pooled_cost


def row(key, structure, parameters, selection, test, bags="noise", seed=1, **more):
    pooled = {"road": {"J": test, "ci95": [test - 1.0, test + 1.0]}}
    costs = [{"set": "identification", "J": selection, "recording": "a"}, {"set": "road", "J": test, "recording": "b"}]
    return {
        "key": key, "status": "done", "bags": bags, "structure": structure, **more, "seed": seed,
        "size": f"{parameters} terms",
        "parameters": parameters, "selection_J": selection, "costs": costs, "pooled": pooled, "gain": 0.9,
        "force_bound_N": 1e5, "seconds": 1.5, "trials": 3, "ended": "done",
    }  # fmt: skip


ROWS = (
    row("aa", "polynomial", 4, 12.0, 20.0, terms=4),
    row("ab", "polynomial", 10, 6.0, 10.0, terms=10),
    row("ac", "polynomial", 10, 9.0, 9.5, terms=10, seed=2),
    row("ad", "sigmoid", 30, 5.8, 11.0, units=8),
    row("ba", "polynomial", 6, 7.0, 8.0, bags="sweep", terms=4),
    {"key": "ae", "status": "failed", "reason": "too short <1 s", "bags": "noise", "structure": "anfis", "seed": 1},
)
NAMES = CellNames(("terms", "units", "seed"), with_bags=True)
RESULTS = CampaignRows(ROWS, len(ROWS), NAMES)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sizes of models")
    for name in ("models/ab.json", "reports/ab.html"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("{}")
    write_campaign_page(folder / PAGE, RESULTS, folder, "sizes", {"command": "ces identify --campaign"})
    return folder


def test_names_tell_the_cells_apart():
    names = [RESULTS.names.full_name(one) for one in ROWS]
    assert len(set(names)) == len(ROWS)
    assert names[1] == "noise: polynomial, 10 terms, seed 1"  # without settings that never vary


def test_every_front_belongs_to_its_bags():
    assert RESULTS.front_keys() == {"aa", "ab", "ad", "ba"}
    assert {name: one["key"] for name, one in RESULTS.recommended().items()} == {"noise": "ab", "sweep": "ba"}


def test_costs_over_a_set_have_an_interval():
    assert pooled_cost(ROWS[0], "road") == (20.0, [19.0, 21.0])
    assert pooled_cost(ROWS[-1], "road") == (None, None)


def test_links_and_failures(folder):
    text = (folder / PAGE).read_text(encoding="utf-8")
    assert 'href="models/ab.json"' in text and 'href="reports/ab.html"' in text and "models/aa.json" not in text
    assert "too short &lt;1 s" in text
    assert "5 of 6 cells have a model; 1 failed." in text
    write_campaign_page(folder.parent / "else.html", RESULTS, folder, "sizes", {})
    assert f'href="{folder.name.replace(" ", "%20")}/models/ab.json"' in (folder.parent / "else.html").read_text()


def test_an_interrupted_campaign_says_what_is_to_come(tmp_path):
    write_campaign_page(tmp_path / PAGE, CampaignRows(ROWS[:2], 9, NAMES), tmp_path, "sizes", {})
    text = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "2 of 9 cells have a model; 7 to come." in text


@pytest.mark.slow
def test_the_page_is_legible_on_screen_in_print_and_by_keys(folder):
    assert find_faults(folder / PAGE) == []


@pytest.mark.slow
def test_the_table_is_sorted_with_mouse_and_keyboard(folder):
    with open_page(folder / PAGE) as page:
        column = [cell.strip() for cell in page.locator("#cells thead th").all_inner_texts()]
        size = next(i for i, text in enumerate(column) if text.startswith("Size"))

        def sizes():
            return [int(cells) for cells in page.locator(f"#cells tbody td:nth-child({size + 1})").all_inner_texts()]

        heading = page.locator("#cells thead th").nth(size)
        heading.locator("button").click()
        assert sizes() == [4, 6, 10, 10, 30] and heading.get_attribute("aria-sort") == "ascending"
        page.keyboard.press("Enter")  # the button has the focus
        assert sizes() == [30, 10, 10, 6, 4] and heading.get_attribute("aria-sort") == "descending"


@pytest.mark.slow
def test_a_point_of_the_front_shows_its_name(folder):
    with open_page(folder / PAGE) as page:
        page.locator("#size0-plot").scroll_into_view_if_needed()
        at = "p => { const b = p.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }"
        x, y = page.locator("#size0-plot path.spot").last.evaluate(at)
        page.mouse.move(x + 2, y + 2)
        read = page.locator("#size0-plot .plot-readout").inner_text()
        assert "polynomial, 4 terms, seed 1: selection 12.00 %" in read


def test_every_delay_has_its_front_and_a_place_in_the_chart_of_cost_over_delay(tmp_path):
    later = [
        row("da", "polynomial", 4, 12.0, 20.0, terms=4, delay=0.0),
        row("db", "polynomial", 4, 7.0, 9.0, terms=4, delay=0.003),
        row("dc", "polynomial", 9, 6.9, 8.0, terms=9, delay=0.003),
    ]
    results = CampaignRows(tuple(later), 3, CellNames(("terms", "delay"), with_bags=False))
    assert results.front_keys() == {"da", "db", "dc"}
    found = {name: one["key"] for name, one in results.recommended().items()}
    assert found == {"noise, delay 0 ms": "da", "noise, delay 3 ms": "db"}
    assert results.names.name(later[2]) == "polynomial, 9 terms, delay 3 ms"
    write_campaign_page(tmp_path / PAGE, results, tmp_path, "delays", {})
    text = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "Cost over delay, identified on noise" in text and "Delay [ms]" in text
    write_campaign_page(tmp_path / PAGE, RESULTS, tmp_path, "sizes", {})
    assert "Cost over delay" not in (tmp_path / PAGE).read_text(encoding="utf-8")
