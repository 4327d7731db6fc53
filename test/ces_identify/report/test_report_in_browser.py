"""Reports in a real browser: drawn at once, worked with by mouse, touch and keys, legible to all, whole in print."""

from __future__ import annotations

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from browser import find_faults, open_page
from diagnoses import named
from patience import wait_until
from report_examples import SAMPLING, damper, model

from ces_gap.report.page import report_page
from ces_identify.report.figures import choose_window
from ces_identify.report.page import write_report
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, evaluate
from ces_report.shell import PageHead

MAX_DRAWING_S = 1.0
COMMAND = "ces identify " + " ".join(f"bags/a_rather_long_name_of_a_recording_{n}" for n in range(9))
pytestmark = pytest.mark.slow
FIRST_FRAME = "#tp0-plot .plot-frame"
NEXT_FRAMES = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
STEP_S, HELD = 0.02, 8  # between two events of a touch; events at its end
VIEW = "() => [...document.getElementById('tp0-plot').interactivePlot.view]"
LONG = model(sampling=replace(SAMPLING, rate_Hz=1000.0))


@pytest.fixture(scope="module")
def evaluations():
    """Three recordings of 8 s at 1 kHz."""
    series = [damper(f"road_{n}", ticks=8_000, seed=n, rate_Hz=1000.0) for n in (1, 2, 3)]
    return evaluate(LONG, series[:1], IDENTIFICATION) + evaluate(LONG, series[1:], VALIDATION)


@pytest.fixture(scope="module")
def report(evaluations, tmp_path_factory):
    path = tmp_path_factory.mktemp("pages") / "report.html"
    write_report(path, PageHead("Model rear_damper.json", command=COMMAND), LONG, evaluations)
    return path


@pytest.fixture(scope="module")
def pages(report):
    """A page of each kind."""
    folder = report.parent
    found = {"report": report, "gap": folder / "gap.html"}
    found["gap"].write_text(report_page(named(), PageHead("Gap of model.json", command=COMMAND)))
    return found


@pytest.fixture(scope="module")
def opened(report):
    with open_page(report, height=2400) as page:
        yield page


@pytest.fixture
def page(opened):
    """The report as it is just after it was opened."""
    opened.mouse.move(0, 0)
    opened.set_viewport_size({"width": 1280, "height": 2400})
    opened.reload()
    return opened


def drawing_time(page):
    """The processor time [s] in which the browser reads, lays out and draws a page, whatever runs beside it."""
    browser = page.context.new_cdp_session(page)
    browser.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.reload()
    metrics = {one["name"]: one["value"] for one in browser.send("Performance.getMetrics")["metrics"]}
    return float(metrics["TaskDuration"])


def ticks(page, ident, area):
    """The numbers at the x axis of an area."""
    texts = page.locator(f"#{ident}-plot g.area").nth(area).locator("text.mid").all_text_contents()
    return [float(text.replace("−", "-")) for text in texts]


def values(page, ident):
    """The values that the chart reads out, by name."""
    text = page.locator(f"#{ident}-plot .plot-readout").inner_text().replace("−", "-")
    found = re.findall(r"(\S+|Error, measured - simulated) (-?[\d.]+) (?:s|N|m/s)", text)
    return {name: float(value) for name, value in found}


def middle(page, ident, across=0.5, down=0.2):
    frame = page.locator(f"#{ident}-plot .plot-frame")
    frame.scroll_into_view_if_needed()
    box = frame.bounding_box()
    return box["x"] + across * box["width"], box["y"] + down * box["height"]


def has_shadow(page, table):
    """Return whether a shadow is drawn along the right edge of what scrolls: whether its colour changes the picture."""
    table.scroll_into_view_if_needed()
    box = table.bounding_box()
    clip = {"x": box["x"] + box["width"] - 6.0, "y": box["y"], "width": 6.0, "height": box["height"]}
    pictures = []
    for colour in ("red", "transparent"):
        table.evaluate("(e, colour) => e.style.setProperty('--more', colour)", colour)
        pictures.append(page.screenshot(clip=clip))
    return pictures[0] != pictures[1]


def test_a_page_is_drawn_at_once(report):
    with open_page(report) as page:
        assert 0.0 < drawing_time(page) < MAX_DRAWING_S


def test_a_drag_zooms_all_areas_and_a_double_click_resets(page):
    first = ticks(page, "tp0", 1)
    x, y = middle(page, "tp0", 0.3)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 150, y + 20, steps=3)
    page.mouse.up()
    zoomed = ticks(page, "tp0", 1)
    assert zoomed != first and first[0] <= zoomed[0] and zoomed[-1] <= first[-1]
    assert np.diff(zoomed).max() < np.diff(first).max()
    assert ticks(page, "tp0", 2)[0] == 0.0  # the overview still shows all
    page.mouse.dblclick(x, y)
    assert ticks(page, "tp0", 1) == first


def test_the_wheel_zooms_a_chart_in_use_only(page):
    first = ticks(page, "tp0", 1)
    x, y = middle(page, "tp0", 0.6)
    page.mouse.move(x, y)
    page.mouse.wheel(0, -200)
    assert ticks(page, "tp0", 1) == first
    page.mouse.click(*middle(page, "tp0", 0.6))
    for _ in range(4):
        page.mouse.wheel(0, -200)
    wait_until(lambda: np.diff(ticks(page, "tp0", 1)).max() < np.diff(first).max())


def test_the_cursor_reads_the_recorded_values(page, evaluations):
    shown = evaluations[1]  # validation comes first in the report
    page.mouse.move(*middle(page, "tp0", 0.37))
    read = values(page, "tp0")
    tick = round((read["Time"] - float(shown.series.time_s[0])) * 1000.0)
    window = choose_window(shown)
    assert window.start < tick < window.stop
    assert read["measured"] == pytest.approx(shown.series.force[tick], abs=0.1)
    assert read["simulated"] == pytest.approx(shown.run.force[tick], abs=0.1)
    error = next(value for name, value in read.items() if name not in ("Time", "measured", "simulated"))
    assert error == pytest.approx(shown.series.force[tick] - shown.run.force[tick], abs=0.1)


def test_the_cursor_reads_the_nearest_point_of_a_cloud(page, evaluations):
    page.mouse.move(*middle(page, "sf0", 0.5, 0.5))
    text = page.locator("#sf0-plot .plot-readout").inner_text().replace("−", "-")
    speed, name, force = re.fullmatch(r"Speed (\S+) m/s\s+(measured|simulated) (\S+) N", text).groups()
    series, run = evaluations[1].series, evaluations[1].run
    forces = series.force if name == "measured" else run.force
    apart = np.hypot((series.speed - float(speed)) / 1e-3, (forces - float(force)) / 1.0)
    assert apart.min() < 1.0


def test_keys_do_what_the_mouse_does(page):
    frame = page.locator("#tp0-plot .plot-frame")
    first = ticks(page, "tp0", 1)
    frame.focus()
    assert frame.evaluate("e => getComputedStyle(e).outlineStyle") == "solid"
    page.keyboard.press("Home")
    start = values(page, "tp0")["Time"]
    page.keyboard.press("ArrowRight")
    step = values(page, "tp0")["Time"]
    page.keyboard.press("End")
    assert start < step < values(page, "tp0")["Time"]
    assert page.locator("#tp0-plot .plot-readout").get_attribute("aria-live") == "polite"
    page.keyboard.press("+")
    assert ticks(page, "tp0", 1) != first
    page.keyboard.press("a")
    assert ticks(page, "tp0", 1) == ticks(page, "tp0", 2)  # all, as the overview
    page.keyboard.press("0")
    assert ticks(page, "tp0", 1) == first


def test_the_legend_hides_a_line_and_shows_it_again(page):
    button = page.locator("#tp0-plot .plot-legend button", has_text="simulated")
    paths = page.locator("#tp0-plot g.area path.simulated")
    assert paths.count() == 1
    button.press("Enter")
    assert (paths.count(), button.get_attribute("aria-pressed")) == (0, "false")
    button.press("Enter")
    assert (paths.count(), button.get_attribute("aria-pressed")) == (1, "true")


def test_charts_of_a_group_follow_each_other(pages):
    with open_page(pages["gap"], height=3600) as page:
        first = ticks(page, "sf-after", 1)
        page.locator("#sf-before-plot .plot-controls button", has_text="+").click()
        assert ticks(page, "sf-before", 1) == ticks(page, "sf-after", 1) != first


@pytest.mark.parametrize("which", ["report", "gap"])
def test_every_page_is_legible_on_screen_in_print_and_by_keys(pages, which):
    assert find_faults(pages[which]) == []


def test_a_table_that_scrolls_shows_it_and_keeps_its_names(page):
    page.set_viewport_size({"width": 390, "height": 900})
    table = page.locator("#costs .wide").first
    assert table.evaluate("e => e.scrollWidth > e.clientWidth + 50")
    assert has_shadow(page, table)  # more is to come
    table.evaluate("e => { e.scrollLeft = e.scrollWidth; }")
    assert not has_shadow(page, table)
    name = table.locator("tbody td").first.bounding_box()
    assert name["x"] == pytest.approx(table.bounding_box()["x"], abs=1.0)


def test_without_a_script_the_page_is_whole(report):
    with open_page(report, scripts=False) as page:
        assert page.locator("#tp0-plot svg path.measured").count() > 1  # legend and figure
        assert page.locator("#tp0-plot .plot-table tbody tr").count() == 3
        assert not page.locator("button").count()


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """The page of one recording."""
    path = tmp_path_factory.mktemp("small") / "report.html"
    write_report(path, PageHead("Model a.json"), model(), evaluate(model(), [damper("road")], VALIDATION))
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


def test_keys_go_from_cell_to_cell_of_a_map(small):
    with open_page(small) as page:
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


def test_tab_reaches_every_chart_in_the_order_of_the_page(pages):
    with open_page(pages["gap"]) as page:
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


def test_a_screen_reader_finds_every_chart_by_name(small):
    with open_page(small) as page:
        seen = page.locator("main").aria_snapshot()
        names = page.evaluate("[...document.querySelectorAll('main svg[role=img] > title')].map(t => t.textContent)")
        assert len(names) >= 5
        for name in names:
            assert f'application "{name}' in seen, name
        assert seen.count("Values of this chart") >= len(names)


def test_forced_colours_keep_bars_and_lines_apart(pages):
    parts = (".length.before", "backgroundColor"), (".length.after", "backgroundColor"), ("path.measured", "stroke")
    with open_page(pages["gap"]) as page:
        page.emulate_media(forced_colors="active")
        script = "([e, what]) => getComputedStyle(document.querySelector(e))[what]"
        assert len({page.evaluate(script, list(part)) for part in (("body", "backgroundColor"), *parts)}) == 4


def test_one_finger_scrolls_the_page_then_moves_the_chart_and_reads_a_cell(small):
    with open_page(small, touch=True, width=900, height=700) as page:
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
