"""Sequences: parts follow one another with times of their own, begin again, and refuse what is no part."""

import numpy as np
import pytest

from ces_rig.drive.currents import make_current
from ces_rig.drive.strokes import make_stroke
from ces_rig.errors import RigError

TIME = np.arange(0.0, 10.0, 1e-3)
SINE = {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 2.0, "duration_s": 3.0}
REST = {"kind": "rest", "duration_s": 1.0}


def stroke(*parts):
    given = make_stroke({"kind": "sequence", "parts": list(parts)}, "x.yaml: stroke")
    return given.samples(TIME, np.random.default_rng(1))


def current(*parts):
    given = make_current({"kind": "sequence", "parts": list(parts)}, "x.yaml: current")
    return given.samples(TIME, np.zeros_like(TIME), np.random.default_rng(1))


def test_strokes_follow_one_another_and_begin_again():
    x = stroke(SINE, REST)
    assert not x[3001:4000].any()
    alone = make_stroke({k: v for k, v in SINE.items() if k != "duration_s"}, "x").samples(TIME[:3000], None)
    np.testing.assert_array_equal(x[:3000], alone)
    np.testing.assert_allclose(x[4000:7000], alone, atol=1e-12)
    assert np.abs(np.diff(x)).max() <= 1.01 * 0.01 * 4 * np.pi * 1e-3  # no jump between the parts


def test_currents_follow_one_another():
    steps = {"kind": "steps", "levels_A": [0.3, 0.5], "hold_s": 0.5, "duration_s": 2.0}
    i = current({"kind": "constant", "current_A": 0.7, "duration_s": 1.0}, steps)
    at = [0.5, 1.2, 1.7, 2.2, 2.7, 3.5, 4.2]
    assert i[[round(1000 * t) for t in at]].tolist() == [0.7, 0.3, 0.5, 0.3, 0.5, 0.7, 0.3]


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([], "expected a list of 1 to 1000 parts"),
        ([3], "part 1 is 3; expected a mapping with kind and duration_s"),
        ([{"kind": "rest"}], "part 1: 'duration_s' is missing"),
        ([REST, {"kind": "sequence", "parts": [REST], "duration_s": 1.0}], "part 2 .* no sequence in it"),
        ([{"kind": "wave", "duration_s": 1.0}], "part 1: kind is 'wave'"),
    ],
)
def test_mistakes_name_the_part(parts, expected):
    with pytest.raises(RigError, match=expected):
        stroke(*parts)


def test_a_controller_of_the_damper_is_no_part():
    with pytest.raises(RigError, match="part 1: kind is 'reg1', which needs the damper"):
        current({"kind": "reg1", "duration_s": 1.0})
