"""`ces serve` in a real browser: lists, keys, comparing by clicking, a search that grows; no error, no other server."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import find_clipped, find_low_contrast, open_page, start_browser
from page_servers import serving
from served_folders import described_model, fill_folder

from ces_identify.progress_file import SearchProgressFile

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


def test_the_overview_is_filtered_and_sorted(url: str) -> None:
    with own_page(url) as page:
        rows = page.locator("tbody tr")
        expect(rows).to_have_count(9)
        page.get_by_label("Filter").fill("friction")
        page.keyboard.press("Enter")
        expect(rows).to_have_count(2)
        page.goto(f"{url}list/model")
        page.get_by_role("button", name="J % validation").click()
        expect(page.locator("td.item a").first).to_have_text("first.json")
        page.get_by_role("button", name="J % validation").click()
        expect(page.locator("td.item a").first).to_have_text("aa11.json")


def test_two_models_are_compared_by_clicking(url: str) -> None:
    with own_page(f"{url}list/model") as page:
        for name in ("first.json", "second.json"):
            page.get_by_label(f"Compare {name}").check()
        page.get_by_role("button", name="Compare").click()
        expect(page.get_by_label("recordings/sine_4hz")).to_be_checked()
        page.get_by_role("button", name="Compare").click()
        expect(page).to_have_title(re.compile("(first and second|second and first) on sine_4hz"))
        costs = page.locator("table").first
        expect(costs).to_contain_text("first")
        expect(costs).to_contain_text("second")
        assert page.locator(".plot-frame").count() >= 2  # the overlaid forces, with their script running in the sandbox


def test_a_running_search_grows_and_ends(tmp_path: Path) -> None:
    facts = {"starts": 2, "seconds": 60.0}
    with serving(tmp_path) as address, SearchProgressFile("identify", tmp_path / "new.json", facts) as file:
        file.write({"seed": 1, "cost": 30.0, "size": 2, "ended": "running"})
        with own_page(address) as page:
            page.locator(".running a").click()
            expect(page.locator(".headline")).to_contain_text("J = 30.00 %")
            for cost in (20.0, 12.0, 8.25, 80.0):
                file.write({"seed": 1, "cost": cost, "size": 5, "ended": "running"})
            expect(page.locator(".headline")).to_contain_text("J = 8.25 %")
            expect(page.locator("#search-plot")).to_contain_text("up to 5 times the best")
            described_model().save(tmp_path / "new.json")
            file.__exit__(None, None, None)
            page.get_by_role("link", name=re.compile("new.json, changed")).click()
            expect(page.locator(".headline")).to_contain_text("olynomial, 3 terms")


def test_a_recording_shows_its_signals(url: str) -> None:
    with own_page(f"{url}view/recording/recordings/sine_4hz") as page:
        expect(page.locator("#signals-plot g.area")).to_have_count(3)
        expect(page.locator(".block tbody tr").first).to_contain_text("1000.0")


def test_a_report_runs_its_own_script_in_an_origin_of_its_own(url: str) -> None:
    with own_page(f"{url}files/worn/report.html") as page:
        assert page.evaluate("typeof plots") == "object"
        assert page.evaluate("self.origin") == "null"


NARROW = ("", "list/model", "view/model/first.json", "view/result/sizes/results.jsonl", "compare?model=first.json")
LISTS = ("list/result", "list/report", "list/recording")
THINGS = ("view/result/fleet/fleet.jsonl", "view/result/loop/iterations.jsonl")
LOOKS = [
    (390, "light", (*NARROW, *LISTS, *THINGS)),
    (800, "dark", NARROW),
    (1280, "light", ("list/model",)),
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
