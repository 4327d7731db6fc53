"""A real browser for tests of pages: one instance for all tests of a run, pages without network, and what went wrong.

A test that uses it skips in one line where playwright or Chromium is missing.
"""

from __future__ import annotations

import atexit
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Literal

import pytest
from needs import skip_missing
from patience import PATIENCE_S

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PATIENCE_MS = 1e3 * PATIENCE_S
CHECKS = (Path(__file__).parent / "page_checks.js").read_text(encoding="utf-8").strip()
A4_PX = {"width": 698, "height": 1032}  # the printable part of A4 with the page's margins, at 96 px an inch


def start_browser() -> Any:
    """Return the browser of this test run; skips the test where there is none."""
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    browser, problem = _launch_browser()
    if problem:
        skip_missing("Chromium", problem)
    return browser


@cache
def _launch_browser() -> tuple[Any, str]:
    """Return the browser, or None and what is wrong with it: the system's, or the one that playwright has installed."""
    from playwright.sync_api import Error, expect, sync_playwright

    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    expect.set_options(timeout=PATIENCE_MS)
    session = sync_playwright().start()
    try:
        browser = session.chromium.launch(executable_path=program, args=list(FLAGS), timeout=PATIENCE_MS)
    except Error as error:
        session.stop()
        return None, f"there, but does not start ({str(error).splitlines()[0]})" if program else "missing"
    atexit.register(session.stop)
    atexit.register(browser.close)
    return browser, ""


@contextmanager
def open_page(
    address: Path | str,
    *,
    width: int = 1280,
    height: int = 900,
    scheme: Literal["light", "dark"] = "light",
    media: Literal["screen", "print"] = "screen",
    network: bool = False,
    touch: bool = False,
    scripts: bool = True,
) -> Iterator[Any]:
    """Yield a playwright page that shows a file or a URL, and close it.

    Afterwards it must have had no error on its console and, without `network`, no request but for itself.
    """
    url = address.resolve().as_uri() if isinstance(address, Path) else address
    context = start_browser().new_context(
        viewport={"width": width, "height": height},
        color_scheme=scheme,
        has_touch=touch,
        java_script_enabled=scripts,
        reduced_motion="reduce",
    )
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    wrong: list[str] = []
    page.on("console", lambda m: wrong.append(f"console: {m.text}") if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: wrong.append(f"script: {error}"))
    page.on("request", lambda r: None if network or r.url.split("#")[0] == url else wrong.append(f"request: {r.url}"))
    try:
        page.emulate_media(media=media, color_scheme=scheme)
        page.goto(url)
        yield page
    finally:
        context.close()
    assert wrong == []


def find_faults(path: Path) -> list[str]:
    """Return what is wrong with a page: in light and dark, on a phone, in forced colours, in print, and by keys."""
    with open_page(path) as page:
        faults: list[str] = _check(page, "findUnnamed")
        for width, scheme in ((1280, "light"), (800, "dark")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            faults += [f"{width} px, {scheme}: {fault}" for fault in (*_find_illegible(page), *find_low_contrast(page))]
        page.set_viewport_size({"width": 390, "height": 900})
        faults += [f"390 px: {fault}" for fault in _find_illegible(page)]
        page.emulate_media(forced_colors="active")
        faults += [f"forced colours: {fault}" for fault in find_low_contrast(page)]
        faults += find_silent_charts(page)
        page.set_viewport_size(A4_PX)
        page.emulate_media(media="print", forced_colors="none")
        faults += [f"print: {fault}" for fault in _find_illegible(page)]
        controls = page.locator(":is(.plot-controls, .plot-readout, .value-label):visible")
        faults += ["print: controls are visible"] if controls.count() else []
        assert page.pdf(format="A4").startswith(b"%PDF")
    return faults


def find_silent_charts(page: Any) -> list[str]:
    """Return the charts of a page that say nothing when the arrow keys read their values, or show no focus."""
    silent = []
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    for frame in page.locator(".plot-frame, .value-frame").all():
        frame.focus()
        page.keyboard.press("ArrowRight")
        read, outline, empty = frame.evaluate(
            """e => [
              (e.querySelector(".value-label") ?? e.parentElement.querySelector(".plot-readout:not(.idle)"))
                ?.textContent,
              getComputedStyle(e).outlineStyle,
              [...e.querySelectorAll("text")].some(t => t.textContent === "no values"),
            ]"""
        )
        if outline != "solid" or not (read or empty):
            silent.append(f"{frame.get_attribute('aria-label')}: reads {read!r}, outline {outline}")
    return silent


def find_clipped(page: Any) -> list[str]:
    """Return the elements of a page that are cut off, or wider than the page; those that scroll are not."""
    return _check(page, "findClipped")


def find_collisions(page: Any) -> list[str]:
    """Return the pairs of texts in one figure whose boxes overlap."""
    return _check(page, "findCollisions")


def find_low_contrast(page: Any) -> list[str]:
    """Return texts whose contrast with what is behind them is below 4.5 (WCAG 2.2 AA; 3 for large ones)."""
    return _check(page, "findLowContrast")


def _find_illegible(page: Any) -> list[str]:
    return [*find_clipped(page), *find_collisions(page)]


def _check(page: Any, name: str) -> list[str]:
    found: list[str] = page.evaluate(f"{CHECKS}.{name}()")
    return found
