"""`ces serve` in a real browser: lists, keys, comparing by clicking; no error, no other server."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import find_clipped, find_low_contrast, open_page, start_browser
from served_folders import fill_folder

from ces_cli.desk.app import PageServer

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
from playwright.sync_api import expect

pytestmark = pytest.mark.slow


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Yield the address of a server of `folder`."""
    server = PageServer(folder, "127.0.0.1", 0)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server.url
    finally:
        server.stop()
        thread.join()


@contextmanager
def own_page(url: str) -> Iterator[Any]:
    """Yield a page that asks this server only, and has no error."""
    asked: list[str] = []
    with open_page("about:blank", network=True) as page:
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
        expect(rows).to_have_count(8)
        page.get_by_label("Filter").fill("friction")
        page.keyboard.press("Enter")
        expect(rows).to_have_count(2)
        page.goto(f"{url}list/model")
        group = page.locator("tbody", has_text="Tested on sine_4hz").filter(has_text="first.json")
        for model in ("first.json", "aa11.json"):  # rising, then falling, among the models of the same tests
            page.get_by_role("button", name="J % validation").click()
            expect(group.locator("td.item a").first).to_have_text(model)


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


RESULTS = ("sizes/results.jsonl", "fleet/fleet.jsonl", "loop/iterations.jsonl")
LOOKS = (
    (390, "light", ("", "list/model", "list/result", "list/report", "list/recording", "compare?model=first.json")),
    (390, "light", ("view/model/first.json", *(f"view/result/{path}" for path in RESULTS))),
    (800, "dark", ("", "list/model", "view/model/first.json", f"view/result/{RESULTS[0]}", "compare?model=first.json")),
    (1280, "light", ("list/model",)),
)
SCROLLED = "tables => tables.filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent)"


def test_pages_fit_and_have_contrast_and_reports_run_their_script(url: str) -> None:
    with own_page(url) as page:
        for width, scheme, paths in LOOKS:
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            for path in paths:
                page.goto(f"{url}{path}")
                wrong = find_clipped(page) + find_low_contrast(page)
                wrong += page.locator("main .wide:not(.plot-table *)").evaluate_all(SCROLLED)
                assert wrong == [], (width, scheme, path)
        page.goto(f"{url}files/worn/report.html")
        assert page.evaluate("[typeof plots, self.origin]") == ["object", "null"]  # in an origin of its own
