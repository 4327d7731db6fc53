"""Sequences of strokes and currents, and strokes from CSV files; mistakes name the part or the line."""

import numpy as np
import pytest

from ces_data.waveforms.sequences import read_stroke_file
from ces_data.waveforms.strokes import make_stroke
from ces_observer.errors import CesError
from ces_rig.experiments.virtual import load_experiment, make_current, simulate_truth

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


GOOD = "time_s,position_m,current_A\n" + "".join(f"{0.1 * n},{0.01 * np.sin(n)},0.5\n" for n in range(8))


def test_a_file_beside_the_experiment_is_its_stroke(tmp_path):
    (tmp_path / "stroke.csv").write_text(GOOD)
    path = tmp_path / "e.yaml"
    path.write_text(
        "duration_s: 1.0\nstroke: {kind: file, path: stroke.csv, fade_s: 0.0}\n"
        "current: {kind: constant, current_A: 0.5}\n"
    )
    truth = simulate_truth(load_experiment(path))
    at_samples = truth.stroke_m[np.round(0.1 * np.arange(8) / 0.5e-3).astype(int)]
    assert at_samples == pytest.approx(0.01 * np.sin(np.arange(8)), abs=1e-9)
    assert np.ptp(truth.stroke_m[1401:]) == 0.0  # at rest after the last sample


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("t,x\n0,0\n", r"s\.csv: columns are t, x; expected time_s, position_m"),
        ("", r"s\.csv: columns are none"),
        ("time_s,position_m\n0,0\n1,0\n", "2 samples; expected at least 4"),
        (GOOD.replace("0.2,", "0.05,", 1), r"s\.csv:4: time_s does not rise"),
        (GOOD.replace("0.1,", "x,", 1), r"s\.csv:3: 'x,"),
        (GOOD.replace("0.1,", "nan,", 1), r"s\.csv:3: 'nan,.*expected finite numbers"),
    ],
)
def test_mistakes_name_the_line(tmp_path, text, says):
    path = tmp_path / "s.csv"
    path.write_text(text)
    with pytest.raises(CesError, match=says) as caught:
        read_stroke_file(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CesError, match=r"none\.csv: cannot be read"):
        read_stroke_file(tmp_path / "none.csv")
