"""Charts for every reader: a finger, the keyboard alone, a screen reader's view of the page, forced colours."""

from __future__ import annotations

import time

import pytest
from browser import open_page
from diagnoses import named
from report_examples import damper, model

from ces_gap.report.page import report_page
from ces_identify.report.page import write_report
from ces_identify.validation.evaluate import VALIDATION, evaluate

pytestmark = pytest.mark.slow
FIRST_FRAME = "#tp0-plot .plot-frame"
NEXT_FRAMES = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
STEP_S, HELD = 0.02, 8  # between two events of a touch; events at its end


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    path = tmp_path_factory.mktemp("touched") / "report.html"
    write_report(path, "Model a.json", model(), evaluate(model(), [damper("road")], VALIDATION), {})
    return path


@pytest.fixture(scope="module")
def gap(tmp_path_factory):
    path = tmp_path_factory.mktemp("gap") / "report.html"
    path.write_text(report_page(named(), "Gap of model.json", {}))
    return path


class Finger:
    """A finger on a page, as the browser gets it from a touch screen."""

    def __init__(self, page):
        self.session = page.context.new_cdp_session(page)

    def slide(self, start, end, steps=6):
        """Move the finger and hold it at the end, so that nothing rolls on."""
        begin = time.time() - 10.0
        for k in [*range(steps + 1), *[steps] * HELD]:
            x, y = (a + (b - a) * k / steps for a, b in zip(start, end, strict=True))
            begin += STEP_S
            self._send("touchMove" if k else "touchStart", [{"x": x, "y": y}], begin)
        self._send("touchEnd", [], begin + STEP_S)

    def _send(self, kind, points, at_s):
        self.session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points, "timestamp": at_s})


def test_keys_go_from_cell_to_cell_of_a_map(report):
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


def test_tab_reaches_every_chart_in_the_order_of_the_page(gap):
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


def test_a_screen_reader_finds_every_chart_by_name(report):
    with open_page(report) as page:
        seen = page.locator("main").aria_snapshot()
        names = page.evaluate("[...document.querySelectorAll('main svg[role=img] > title')].map(t => t.textContent)")
        assert len(names) >= 5
        for name in names:
            assert f'application "{name}' in seen, name
        assert seen.count("Values of this chart") >= len(names)


def test_forced_colours_keep_bars_and_lines_apart(gap):
    parts = (".length.before", "backgroundColor"), (".length.after", "backgroundColor"), ("path.measured", "stroke")
    with open_page(gap) as page:
        page.emulate_media(forced_colors="active")
        script = "([e, what]) => getComputedStyle(document.querySelector(e))[what]"
        assert len({page.evaluate(script, list(part)) for part in (("body", "backgroundColor"), *parts)}) == 4


VIEW = "() => [...document.getElementById('tp0-plot').interactivePlot.view]"


def test_one_finger_scrolls_the_page_then_moves_the_chart_and_reads_a_cell(report):
    with open_page(report, touch=True, width=900, height=700) as page:
        frame, finger = page.locator(FIRST_FRAME), Finger(page)
        for way_x, way_y, steps in ((0, -150, 12), (120, 0, 6)):
            frame.evaluate("e => e.scrollIntoView({block: 'center'})")
            page.wait_for_function("document.getElementById('tp0-plot').interactivePlot.data")
            first, top, box = page.evaluate(VIEW), page.evaluate("scrollY"), frame.bounding_box()
            x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.25 * box["height"]
            finger.slide((x, y), (x + way_x, y + way_y), steps)
            page.evaluate(NEXT_FRAMES)
            moved = page.evaluate(VIEW)
            if way_y:
                assert page.evaluate("scrollY") > top + 50 and moved == first
        assert moved[0] < first[0] and moved[1] - moved[0] == pytest.approx(first[1] - first[0])
        page.locator("#coverage .value-frame").first.locator(".value").first.tap()
        assert "% of the time" in page.locator(".value-label").first.inner_text()
