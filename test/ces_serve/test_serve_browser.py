"""`ces serve` in a real browser: lists, keys, comparing by clicking, a search that grows; no error, no other server."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import find_clipped, find_low_contrast, open_page, start_browser
from page_servers import serving
from served_folders import described_model, fill_folder

from ces_identify.progress_file import SearchProgressFile
from ces_serve.files.catalogue import FRESH_S

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
from playwright.sync_api import expect


@contextmanager
def own_page(url: str, **look: Any) -> Iterator[Any]:
    """Yield a page that asks this server only, and has no error; `look` as of `open_page`."""
    asked: list[str] = []
    with open_page("about:blank", network=True, **look) as page:
        page.on("request", lambda request: asked.append(request.url))
        page.goto(url)
        yield page
    origin = re.match(r"http://[^/]+/", url)
    assert origin is not None
    assert [address for address in asked if not address.startswith((origin[0], "data:"))] == []


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    start_browser()  # skips before the work where there is none
    with serving(fill_folder(tmp_path_factory.mktemp("results"))) as address:
        yield address


def test_the_overview_is_filtered_and_walked_by_keys(url: str) -> None:
    with own_page(url) as page:
        rows = page.locator("tbody tr")
        expect(rows).to_have_count(9)
        page.keyboard.press("/")
        page.keyboard.type("friction")
        expect(page).to_have_url(re.compile(r"\?q=friction$"))  # the last of the lists that came while typing
        expect(rows).to_have_count(2)
        page.keyboard.press("ArrowDown")
        page.keyboard.press("ArrowDown")
        page.keyboard.press("ArrowUp")
        page.keyboard.press("Enter")
        expect(page.locator("h1")).to_have_text(re.compile("worn|car_1"))
        expect(page.locator(".headline")).to_contain_text("friction")


def test_the_list_is_sorted_by_clicking_its_headings(url: str) -> None:
    with own_page(f"{url}list/model") as page:
        page.get_by_role("link", name="J % validation").click()
        expect(page.locator("td.item a").first).to_have_text("first.json")
        page.get_by_role("link", name="J % validation").click()
        expect(page.locator("td.item a").first).to_have_text("aa11.json")


def test_what_is_new_appears_by_itself(tmp_path: Path) -> None:
    described_model().save(tmp_path / "a.json")
    with serving(tmp_path) as address, own_page(address) as page:
        expect(page.locator("tbody tr")).to_have_count(1)
        described_model().save(tmp_path / "b.json")
        expect(page.locator("tbody tr")).to_have_count(2)


def test_what_came_between_the_page_and_its_stream_appears_too(tmp_path: Path) -> None:
    def come_late(route: Any) -> None:
        described_model().save(tmp_path / "a.json")
        time.sleep(2 * FRESH_S)  # the list is made anew before the stream begins
        route.continue_()

    with serving(tmp_path) as address, open_page("about:blank", network=True) as page:
        page.route("**/events/overview", come_late)
        page.goto(address)
        expect(page.locator("tbody tr")).to_have_count(1)


def test_two_models_are_compared_by_clicking(url: str) -> None:
    with own_page(f"{url}list/model") as page:
        compare = page.locator("#chooser button")
        page.get_by_label("Compare first.json").check()
        expect(compare).to_be_disabled()
        page.locator("#filter").fill("second")
        expect(page.locator("tbody tr")).to_have_count(1)
        page.get_by_label("Compare second.json").check()
        compare.click()
        expect(page.get_by_label("recordings/sine_4hz")).to_be_checked()
        page.get_by_role("button", name="Compare").click()
        page.wait_for_url("**/compare/page/*")
        assert set(page.title().split()) == {"first", "and", "second", "on", "sine_4hz"}
        costs = page.locator("table").first
        expect(costs).to_contain_text("first")
        expect(costs).to_contain_text("second")
        assert page.locator(".plot-frame").count() >= 2  # the overlaid forces, with their script running in the sandbox
        page.go_back()
        expect(page.get_by_role("button", name="Compare")).to_be_visible()


def test_recordings_to_compare_on_are_filtered_and_chosen_ones_stay(tmp_path: Path) -> None:
    start_browser()
    for name in ("first", "second"):
        described_model().save(tmp_path / f"{name}.json")
    for k in range(13):
        (tmp_path / f"week_{k}.mcap").touch()
    (tmp_path / "sine_4hz").mkdir()
    (tmp_path / "sine_4hz" / "metadata.yaml").touch()  # on which both were validated
    with serving(tmp_path) as address, own_page(f"{address}compare?model=first.json&model=second.json") as page:
        shown = page.locator("#recordings li:visible")
        expect(shown.first).to_contain_text("sine_4hz")
        expect(page.get_by_role("button", name="Compare")).to_be_in_viewport()
        page.get_by_label("Filter").fill("week 12")
        expect(shown).to_have_count(2)
        expect(shown.locator("input:checked")).to_have_count(1)


def test_a_folder_that_is_moved_away_is_missed_and_found_again(tmp_path: Path) -> None:
    start_browser()
    folder = tmp_path / "results"
    folder.mkdir()
    described_model().save(folder / "a.json")
    with serving(folder) as address, own_page(address) as page:
        expect(page.locator("tbody tr")).to_have_count(1)
        folder.rename(tmp_path / "moved")
        expect(page.locator(".warning")).to_contain_text("cannot be read now: No such file or directory")
        (tmp_path / "moved").rename(folder)
        expect(page.locator("tbody tr")).to_have_count(1)


def test_a_comparison_survives_reload_back_and_forward(tmp_path: Path) -> None:
    start_browser()
    with serving(fill_folder(tmp_path)) as address, own_page(f"{address}list/model") as page:
        for name in ("first.json", "second.json"):
            page.get_by_label(f"Compare {name}").check()
        page.locator("#chooser button").click()
        page.get_by_role("button", name="Compare").click()
        expect(page.locator("h1")).to_have_text("Comparing")
        page.reload()  # breaks the first computation off
        page.wait_for_url("**/compare/page/*")
        title = page.title()
        page.go_back()
        expect(page.get_by_label("recordings/sine_4hz")).to_be_checked()
        page.go_back()
        expect(page.get_by_label("Compare first.json")).to_be_visible()
        page.go_forward()
        expect(page.get_by_label("recordings/sine_4hz")).to_be_checked()
        page.go_forward()
        expect(page).to_have_title(title)


def test_a_running_search_grows_and_ends(tmp_path: Path) -> None:
    facts = {"starts": 2, "seconds": 60.0}
    with serving(tmp_path) as address, SearchProgressFile("identify", tmp_path / "new.json", facts) as file:
        file.write({"seed": 1, "cost": 30.0, "size": 2, "ended": "running"})
        with own_page(address) as page:
            page.locator(".running a").click()
            page.mouse.move(0, 0)  # a chart under the mouse stays as it is
            points = page.locator("#search-plot g.area path.spot")
            before = len(points.first.get_attribute("d") or "")
            for cost in (20.0, 12.0, 8.25, 80.0):
                file.write({"seed": 1, "cost": cost, "size": 5, "ended": "running"})
            expect(page.locator(".headline").first).to_contain_text("J = 8.25 %")
            assert len(points.first.get_attribute("d") or "") > before
            expect(page.locator(".plot-frame")).to_have_count(1)  # it can be zoomed after each change
            expect(page.locator("#search-plot")).to_contain_text("up to 5 times the best")
            expect(page.locator("td", has_text="running")).to_have_text("running")
            described_model().save(tmp_path / "new.json")
            file.__exit__(None, None, None)
            expect(page.locator("td", has_text="running")).to_have_text("was running")
            expect(page.locator(".following")).to_have_count(0)
            expect(page.locator(".headline")).to_have_text(["It has ended: new.json, polynomial, 3 terms."])
            page.get_by_role("link", name="new.json").click()
            expect(page.locator(".headline")).to_contain_text("Polynomial, 3 terms")


def test_a_recording_shows_its_signals(url: str) -> None:
    with own_page(f"{url}view/recording/recordings/sine_4hz") as page:
        expect(page.locator("#signals-plot g.area")).to_have_count(3)
        expect(page.locator(".block tbody tr").first).to_contain_text("1000.0")


def test_a_report_runs_its_own_script_in_an_origin_of_its_own(url: str) -> None:
    with own_page(f"{url}files/worn/report.html") as page:
        assert page.evaluate("typeof cesPlots") == "object"
        assert page.evaluate("self.origin") == "null"


NARROW = ("", "list/model", "view/model/first.json", "view/campaign/sizes/results.jsonl", "compare?model=first.json")
LISTS = ("list/diagnosis", "list/iteration", "list/recording")
THINGS = ("view/fleet/fleet/fleet.jsonl", "view/iteration/loop/iterations.jsonl")
LOOKS = [
    (390, "light", (*NARROW, *LISTS, *THINGS)),
    (800, "dark", NARROW),
    (1280, "light", ("list/model", "observer")),
]
SCROLLED = "tables => tables.filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent)"


@pytest.mark.parametrize(("width", "scheme", "paths"), LOOKS)
def test_pages_fit_and_have_contrast(url: str, width: int, scheme: Any, paths: tuple[str, ...]) -> None:
    with own_page(url, width=width, scheme=scheme) as page:
        for path in paths:
            page.goto(f"{url}{path}")
            assert find_clipped(page) == [], path
            assert find_low_contrast(page) == [], path
            assert page.locator("main .wide:not(.plot-table *)").evaluate_all(SCROLLED) == [], path
