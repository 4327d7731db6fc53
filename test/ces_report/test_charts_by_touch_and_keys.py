"""Charts for every reader: a finger, the keyboard alone, a screen reader's view of the page, forced colours."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import find_low_contrast, open_page
from diagnoses import named
from report_examples import damper, model

from ces_gap.report.page import report_page
from ces_identify.report.page import write_report
from ces_identify.validation.evaluate import VALIDATION, evaluate

FIRST_FRAME = "#tp0-plot .plot-frame"
NEXT_FRAMES = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
STEP_S, HELD = 0.02, 8  # between two events of a touch; events at its end


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("touched") / "report.html"
    write_report(path, "Model a.json", model(), evaluate(model(), [damper("road")], VALIDATION), {})
    return path


@pytest.fixture(scope="module")
def constant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a recording with one current: its maps are bars over speed."""
    path = tmp_path_factory.mktemp("constant") / "report.html"
    write_report(path, "Model a.json", model(), evaluate(model(), [damper("road", current_A=0.4)], VALIDATION), {})
    return path


@pytest.fixture(scope="module")
def gap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gap") / "report.html"
    path.write_text(report_page(named(), "Gap of model.json", {}))
    return path


class Fingers:
    """Touches of a page, as the browser gets them from a touch screen."""

    def __init__(self, page: Any) -> None:
        self.page, self.session = page, page.context.new_cdp_session(page)

    def slide(self, *paths: tuple[tuple[float, float], tuple[float, float]], steps: int = 6) -> None:
        """Move a finger along each path, all at the same time, and hold them at its end, so that nothing rolls on."""
        begin = time.time() - 10.0
        for k in [*range(steps + 1), *[steps] * HELD]:
            points = [
                {"x": a[0] + (b[0] - a[0]) * k / steps, "y": a[1] + (b[1] - a[1]) * k / steps, "id": i}
                for i, (a, b) in enumerate(paths)
            ]
            begin += STEP_S
            self._send("touchMove" if k else "touchStart", points, begin)
        self._send("touchEnd", [], begin + STEP_S)

    def _send(self, kind: str, points: list[dict[str, float]], at_s: float) -> None:
        self.session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points, "timestamp": at_s})


@pytest.fixture
def touched(report: Path) -> Iterator[tuple[Any, Fingers]]:
    with open_page(report, touch=True, width=900, height=700) as page:
        page.locator(FIRST_FRAME).evaluate("e => e.scrollIntoView({block: 'center'})")
        yield page, Fingers(page)


def view(page: Any) -> list[float]:
    shown: list[float] = page.evaluate("document.getElementById('tp0-plot').interactivePlot.data && "
                                       "[...document.getElementById('tp0-plot').interactivePlot.view]")  # fmt: skip
    return shown


def middle(page: Any) -> tuple[float, float]:
    box = page.locator(FIRST_FRAME).bounding_box()
    return box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"]


def test_one_finger_scrolls_the_page_and_then_moves_the_chart(touched: tuple[Any, Fingers]) -> None:
    page, fingers = touched
    first, top = view(page), page.evaluate("scrollY")
    x, y = middle(page)
    fingers.slide(((x, y), (x, y - 150)), steps=12)
    page.evaluate(NEXT_FRAMES)
    assert page.evaluate("scrollY") > top + 50
    assert view(page) == first
    page.locator(FIRST_FRAME).evaluate("e => e.scrollIntoView({block: 'center'})")
    x, y = middle(page)
    fingers.slide(((x, y), (x + 120, y)))
    moved = view(page)
    assert moved[0] < first[0] and moved[1] - moved[0] == pytest.approx(first[1] - first[0])


def test_a_touched_cell_of_a_map_says_its_value(report: Path) -> None:
    with open_page(report, touch=True, width=900, height=700) as page:
        cell = page.locator("#coverage .value-frame").first.locator(".value").first
        cell.tap()
        assert "% of the time" in page.locator(".value-label").first.inner_text()


def test_keys_go_from_cell_to_cell_of_a_map(report: Path) -> None:
    with open_page(report) as page:
        frame = page.locator("#coverage .value-frame").last
        label = frame.locator(".value-label")
        frame.focus()
        texts = []
        for key in ("Home", "ArrowRight", "ArrowUp", "ArrowLeft", "ArrowDown", "End"):
            page.keyboard.press(key)
            texts.append(label.inner_text())
        assert texts[0] == texts[4] and len(set(texts[:4])) == 4  # around a square
        assert all("N RMS error" in text for text in texts)
        assert label.get_attribute("aria-live") == "polite"
        page.keyboard.press("Escape")
        assert label.inner_text() == ""


def test_the_label_stays_inside_the_page(gap: Path) -> None:
    with open_page(gap, width=420) as page:
        for value in page.locator(".share-charts .value-frame").last.locator(".value").all():
            value.hover()
            box = page.locator(".value-label:not(:empty)").bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= 420


def test_a_share_chart_reads_what_its_table_says(gap: Path) -> None:
    with open_page(gap) as page:
        figure = page.locator("#where .share-charts figure").first
        figure.locator(".value").nth(1).hover()
        name, values = figure.locator(".value-label").inner_text().split(": ")
        row = figure.locator(".plot-table tbody tr").nth(1)
        assert row.locator("th").text_content() == name
        energy, time, rms = row.locator("td").all_text_contents()
        assert values.startswith(f"{energy} % of the energy, {time} % of the time; RMS {rms} N (")


def test_correlations_zoom_together_and_are_read_together(report: Path) -> None:
    with open_page(report, height=1800) as page:
        plot = page.locator(".correlations .plot")
        labels = plot.locator("g.area").last.locator("text.mid")
        before = labels.all_text_contents()
        plot.locator(".plot-frame").focus()
        page.keyboard.press("Home")
        read = plot.locator(".plot-readout").inner_text()
        assert read.startswith("Lag 0") and "residual with itself * 1.000" in read and "speed → residual" in read
        page.keyboard.press("+")
        page.keyboard.press("+")
        page.keyboard.press("+")
        assert labels.all_text_contents() != before


def test_bars_over_speed_zoom_and_read_every_bar(constant: Path) -> None:
    with open_page(constant) as page:
        plot = page.locator("#coverage-plot")
        plot.locator(".plot-frame").focus()
        read = []
        page.keyboard.press("Home")
        for _ in range(8):
            read.append(plot.locator(".plot-readout").inner_text())
            page.keyboard.press("ArrowRight")
        assert len(set(read)) == 8 and all("Share of time" in text for text in read)
        before = plot.locator("text.mid").all_text_contents()
        page.keyboard.press("+")
        page.keyboard.press("+")
        assert plot.locator("text.mid").all_text_contents() != before


def test_tab_reaches_every_chart_in_the_order_of_the_page(gap: Path) -> None:
    with open_page(gap) as page:
        count = page.locator(".plot-frame, .value-frame").count()
        order: list[int] = []
        for _ in range(12 * count):
            page.keyboard.press("Tab")
            at = page.evaluate(
                "[...document.querySelectorAll('.plot-frame, .value-frame')].indexOf(document.activeElement)"
            )
            order += [at] if at >= 0 else []
            if len(order) == count:
                break
        assert order == list(range(count))


def test_a_screen_reader_finds_every_chart_by_name(report: Path) -> None:
    with open_page(report) as page:
        seen = page.locator("main").aria_snapshot()
        names = page.evaluate("[...document.querySelectorAll('main svg[role=img] > title')].map(t => t.textContent)")
        assert len(names) >= 5
        for name in names:
            assert f'application "{name}' in seen, name
        assert seen.count("Values of this chart") >= len(names)


def test_forced_colours_keep_bars_lines_and_texts(gap: Path) -> None:
    with open_page(gap) as page:
        for scheme in ("light", "dark"):
            page.emulate_media(forced_colors="active", color_scheme=scheme)
            assert page.evaluate("matchMedia('(forced-colors: active)').matches")
            assert find_low_contrast(page) == []
            colours = page.evaluate(
                """() => {
                  const colour = (e, what) => getComputedStyle(document.querySelector(e))[what];
                  return [colour('body', 'backgroundColor'), colour('.length.before', 'backgroundColor'),
                    colour('.length.after', 'backgroundColor'), colour('path.measured', 'stroke')];
                }"""
            )
            assert len(set(colours)) == len(colours)
