"""Charts to work with: what the page shows without a script, and the data from which the script redraws it."""

from __future__ import annotations

import base64
import json
import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ces_report.plot import Plot, PlotArea, PlotBand, PlotDots, PlotLine, PlotScale, PlotShade, draw_chart, draw_plot
from ces_report.typesetting import Chart, ChartCurve, format_within

SVG = "{http://www.w3.org/2000/svg}"
TIME = np.arange(5000) / 1000.0
WAVE = 300.0 * np.sin(2 * np.pi * 3.0 * TIME)


def drawn(plot, max_points=60_000):
    return ET.fromstring(str(draw_plot(plot, max_points)))


def one_area(*marks, **settings):
    return Plot("p", "A chart", "About it.", "Time [s]", [PlotArea("Force [N]", marks)], **settings)


def data_of(root):
    data = json.loads(root.find("script").text)
    arrays = [decode(code) for code in data["arrays"]]
    for area in data["areas"]:
        for mark in area["marks"]:
            mark.update({key: arrays[mark[key]] for key in ("x", "y", "low", "high") if key in mark})
    return data


def decode(code):
    """What the script does."""
    if "even" in code:
        start, step = code["even"]
        return np.full(code["n"], np.nan) if start is None else start + step * np.arange(code["n"])
    kind, missing = ("<u4", 2**32 - 1) if code["bits"] == 32 else ("<u2", 65535)
    whole = np.frombuffer(base64.b64decode(code["data"]), kind)
    return np.where(whole == missing, np.nan, code["low"] + whole * code["unit"])


@given(st.lists(st.floats(-1e6, 1e6) | st.just(np.nan), min_size=1, max_size=50))
def test_values_survive_within_half_a_step(values):
    y = np.array(values)
    mark = data_of(drawn(one_area(PlotLine("a", np.arange(len(y)) + 0.5, y))))["areas"][0]["marks"][0]
    step = (np.nanmax(y) - np.nanmin(y)) / 65534 if np.isfinite(y).any() else 0.0
    np.testing.assert_allclose(mark["y"], y, atol=0.51 * step + 1e-9, equal_nan=True)
    np.testing.assert_allclose(mark["x"], np.arange(len(y)) + 0.5, atol=1e-6)


def test_a_long_line_keeps_its_peak_and_the_page_says_what_was_left_out():
    y = WAVE.copy()
    y[3217] = 900.0
    root = drawn(one_area(PlotLine("a", TIME, y)), max_points=1000)
    mark = data_of(root)["areas"][0]["marks"][0]
    assert len(mark["y"]) <= 1000
    peak = int(np.argmax(mark["y"]))
    assert mark["y"][peak] == pytest.approx(900.0, abs=0.02)
    assert mark["x"][peak] == pytest.approx(TIME[3217], abs=0.01)
    assert "lowest and highest of every 10 samples" in "".join(root.find("p").itertext())
    assert drawn(one_area(PlotLine("a", TIME, y))).find("p") is None


def test_no_group_of_samples_spans_a_gap_or_a_break():
    x = np.concatenate([TIME[:2003], TIME[:2003] + 10.0])
    y = np.where(x < 5.0, 1.0, 2.0)
    breaks = np.zeros(len(x), bool)
    breaks[[0, 1111]] = True
    y[1111:2003] = 7.0
    mark = data_of(drawn(one_area(PlotLine("a", x, y, breaks=breaks)), max_points=400))["areas"][0]["marks"][0]
    assert len(mark["breaks"]) == 1
    at = mark["breaks"][0]
    assert mark["y"][at - 1] == pytest.approx(1.0, abs=0.01) and mark["y"][at] == pytest.approx(7.0, abs=0.01)
    pairs = mark["y"].reshape(-1, 2)
    np.testing.assert_allclose(pairs[:, 0], pairs[:, 1], atol=0.01)  # none holds values of both sides


def test_an_x_that_equals_a_y_keeps_its_resolution():
    """Of a span of 1000 s, 16 bits resolve 15 ms, and 32 bits less than a microsecond."""
    x = np.cumsum(np.random.default_rng(1).random(2000))
    marks = data_of(drawn(one_area(PlotDots("a", np.arange(2000.0), x), PlotDots("b", x, x))))["areas"][0]["marks"]
    assert np.abs(marks[1]["x"] - x).max() < 1e-6
    assert np.abs(marks[1]["y"] - x).max() > 1e-4


def test_names_cannot_end_the_data_or_the_page():
    evil = "</script><script>alert(1)</script>&amp;]]>\"'"
    text = str(draw_plot(one_area(PlotLine(evil, TIME, WAVE))))
    assert "alert(1)</script>" not in text
    root = ET.fromstring(text)
    assert next(root.iter("li")).get("data-name") == evil
    assert data_of(root)["areas"][0]["marks"][0]["name"] == evil


def test_a_band_of_few_points_is_one_area_in_each_piece():
    x = np.linspace(0.0, 1.0, 30)
    low = np.where((x > 0.4) & (x < 0.5), np.nan, x)
    root = drawn(one_area(PlotBand("band", x, low, low + 1.0)))
    bands = [p for p in root.find(f"{SVG}svg").iter(f"{SVG}path") if p.get("class") == "bounds area"]
    assert len(bands) == 2
    assert all(p.get("d").count("M") == 1 for p in bands)


def test_a_shade_is_where_the_mask_is_true():
    shade = PlotShade("outside", TIME, (TIME > 1.0) & (TIME < 2.0) | (TIME > 4.0))
    np.testing.assert_allclose(shade.spans(), [[1.001, 1.999], [4.001, 4.999]])
    np.testing.assert_allclose(shade.spans(2.5), [[1.001, 4.999]])
    assert PlotShade("", TIME, np.zeros(5000, bool)).spans().shape == (0, 2)


def test_the_table_has_the_extremes_of_every_mark():
    root = drawn(one_area(PlotLine("model", TIME, WAVE), PlotBand("band", TIME, WAVE - 1, WAVE + 1)))
    lines = [[cell.text for cell in row.iter("td")] for row in root.iter("tr")]
    rows = {name: values for name, *values in filter(None, lines)}
    names = ("model", "band, lower end", "band, upper end")
    assert list(rows) == [f"{name}: Force [N]" for name in names]
    assert rows["model: Force [N]"][:2] == ["5000", "−300"]


@pytest.mark.parametrize("values", [np.zeros(0), np.full(10, np.nan), np.full(10, 3.0), np.ones(1)])
def test_nothing_and_constants_are_drawn(values):
    text = str(draw_plot(one_area(PlotLine("a", np.arange(float(len(values))), values))))
    assert "nan" not in text.lower()
    assert ("no values" in text) == (not np.isfinite(values).any())


PATH = f"{SVG}path"
X = np.linspace(-1.0, 1.0, 21)


def chart_of(*curves):
    return ET.fromstring(str(draw_chart("c", Chart("Force", "Speed", "Force", curves, "About."), (620, 446))))


def drawn_paths(root):
    """Return the paths of the figure itself, not those of its legend."""
    return list(root.find(f"{SVG}svg").iter(PATH))


def pixels(path):
    """The horizontal pixels of a path."""
    numbers = path.get("d").replace("M", " ").replace("L", " ").replace("Z", " ").split()
    return [float(pair.split(",")[0]) for pair in numbers]


def curve(recorded, half=0.1, name="0.3 A"):
    return ChartCurve(name, X, 10.0 * X, np.full(len(X), half), recorded)


def test_the_pieces_meet_where_the_recorded_speeds_end():
    root = chart_of(curve((-0.43, 0.27)))
    solid = [p for p in drawn_paths(root) if p.get("class") == "curve c1"]
    left, right = [p for p in drawn_paths(root) if p.get("class") == "curve c1 beyond"]
    assert pixels(left)[-1] == pixels(solid[0])[0]
    assert pixels(right)[0] == pixels(solid[0])[-1]
    assert len(solid) == 1


@pytest.mark.parametrize(
    ("recorded", "solid", "dashed"), [((-2.0, 2.0), 1, 0), ((0.0, 0.0), 0, 2), ((-1.0, 0.5), 1, 1)]
)
def test_a_piece_that_is_not_there_is_not_drawn(recorded, solid, dashed):
    classes = [p.get("class") for p in drawn_paths(chart_of(curve(recorded)))]
    assert (classes.count("curve c1"), classes.count("curve c1 beyond")) == (solid, dashed)


def test_each_curve_is_one_entry_of_the_legend_with_all_its_pieces():
    root = chart_of(*(curve((-0.4, 0.3), name=f"{n} A") for n in range(4)))
    assert [entry.get("data-name") for entry in root.iter("li")] == ["0 A", "1 A", "2 A", "3 A"]
    marks = json.loads(root.find("script").text)["areas"][0]["marks"]
    assert [mark["name"] for mark in marks].count("2 A") == 4  # interval, solid piece, two dashed ones


def test_a_legend_of_many_currents_is_a_scale_and_names_the_groups() -> None:
    x = np.linspace(0.0, 1.0, 5)
    marks = [PlotLine(f"{n} A, {of}", x, n * x, group=of) for of in ("measured", "model") for n in range(5)]
    scale = PlotScale([mark.css for mark in marks[:5]], "Current 0", "4 A")

    def legend(some: list[PlotLine]) -> str:
        drawn = str(draw_plot(Plot("p", "t", "t", "x", [PlotArea("y", some)], scale=scale)))
        return drawn[: drawn.index("</ul>")]

    assert 'data-name="3 A, model"' in legend(marks[4:]) and "Current 0" not in legend(marks[4:])
    many = legend(marks)
    assert "Current 0" in many and 'data-name="model"' in many and "3 A, model" not in many


def test_a_value_has_the_digits_that_its_interval_justifies() -> None:
    assert format_within(12.753, 10.991, 14.793) == ("12.8", "11.0 to 14.8")
    assert format_within(8.5, 6.0, 12.0) == ("8", "6 to 12")
    assert format_within(1843.0, 1500.0, 2200.0) == ("1800", "1500 to 2200")
    assert format_within(2.0e-7, 1.0e-7, 3.0e-7) == ("2·10⁻⁷", "1·10⁻⁷ to 3·10⁻⁷")
    assert format_within(50.0, 50.0, 5000.0) == ("50", "50 to 5000")
    assert format_within(1400.0, 1000.0, 9000.0) == ("1400", "1000 to 9000")
    assert format_within(0.0, -0.5, 0.5) == ("0.0", "\N{MINUS SIGN}0.5 to 0.5")
    assert format_within(0.3, -4.0, 5.0) == ("0", "\N{MINUS SIGN}4 to 5")
    assert format_within(5.0, math.nan, math.nan) == ("5", "–")
