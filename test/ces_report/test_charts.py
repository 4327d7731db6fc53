"""Charts of curves: solid where something was recorded, dashed beyond, with a ribbon for the interval."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from ces_report.plot import draw_chart
from ces_report.typesetting import Chart, ChartCurve

SVG = "{http://www.w3.org/2000/svg}"
PATH = f"{SVG}path"
X = np.linspace(-1.0, 1.0, 21)


def drawn(*curves):
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
    root = drawn(curve((-0.43, 0.27)))
    solid = [p for p in drawn_paths(root) if p.get("class") == "curve c1"]
    left, right = [p for p in drawn_paths(root) if p.get("class") == "curve c1 beyond"]
    assert pixels(left)[-1] == pixels(solid[0])[0]
    assert pixels(right)[0] == pixels(solid[0])[-1]
    assert len(solid) == 1


@pytest.mark.parametrize(
    ("recorded", "solid", "dashed"), [((-2.0, 2.0), 1, 0), ((0.0, 0.0), 0, 2), ((-1.0, 0.5), 1, 1)]
)
def test_a_piece_that_is_not_there_is_not_drawn(recorded, solid, dashed):
    classes = [p.get("class") for p in drawn_paths(drawn(curve(recorded)))]
    assert (classes.count("curve c1"), classes.count("curve c1 beyond")) == (solid, dashed)


def test_each_curve_is_one_entry_of_the_legend_with_all_its_pieces():
    root = drawn(*(curve((-0.4, 0.3), name=f"{n} A") for n in range(4)))
    assert [entry.get("data-name") for entry in root.iter("li")] == ["0 A", "1 A", "2 A", "3 A"]
    marks = json.loads(root.find("script").text)["areas"][0]["marks"]
    assert [mark["name"] for mark in marks].count("2 A") == 4  # interval, solid piece, two dashed ones
