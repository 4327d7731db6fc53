"""Charts of curves: solid where something was recorded, dashed beyond, with a ribbon for the interval."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from ces_identify.report.charts import draw_chart
from ces_identify.typesetting import Chart, ChartCurve

PATH = "{http://www.w3.org/2000/svg}path"
X = np.linspace(-1.0, 1.0, 21)


def drawn(*curves):
    return ET.fromstring(str(draw_chart("c", Chart("Force", "Speed", "Force", curves, "About."), (620, 446))))


def pixels(path):
    """The horizontal pixels of a path."""
    numbers = path.get("d").replace("M", " ").replace("L", " ").replace("Z", " ").split()
    return [float(pair.split(",")[0]) for pair in numbers]


def curve(recorded, half=0.1, name="0.3 A"):
    return ChartCurve(name, X, 10.0 * X, np.full(len(X), half), recorded)


def test_the_pieces_meet_where_the_recorded_speeds_end():
    root = drawn(curve((-0.43, 0.27)))
    solid = [p for p in root.iter(PATH) if p.get("class") == "curve c1"]
    left, right = [p for p in root.iter(PATH) if p.get("class") == "curve beyond c1"]
    assert pixels(left)[-1] == pixels(solid[0])[0]
    assert pixels(right)[0] == pixels(solid[0])[-1]
    assert len(solid) == 1


@pytest.mark.parametrize(
    ("recorded", "solid", "dashed"), [((-2.0, 2.0), 1, 0), ((0.0, 0.0), 0, 2), ((-1.0, 0.5), 1, 1)]
)
def test_a_piece_that_is_not_there_is_not_drawn(recorded, solid, dashed):
    classes = [p.get("class") for p in drawn(curve(recorded)).iter(PATH)]
    assert (classes.count("curve c1"), classes.count("curve beyond c1")) == (solid, dashed)


def test_without_errors_there_is_no_ribbon():
    for half, count in ((0.0, 0), (0.5, 1)):
        ribbons = [p for p in drawn(curve((-1.0, 1.0), half)).iter(PATH) if p.get("class") == "interval c1"]
        assert len(ribbons) == count


def test_names_of_close_curves_do_not_overlap():
    root = drawn(*(curve((-1.0, 1.0), name=f"curve {n}") for n in range(4)))
    texts = [t for t in root.iter("{http://www.w3.org/2000/svg}text") if (t.text or "").startswith("curve ")]
    heights = sorted(float(t.get("y")) for t in texts)
    assert len(heights) == 4
    assert min(np.diff(heights)) >= 15.9
