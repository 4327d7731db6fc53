"""The example scripts do what they say, as a user would run them."""

import json
import runpy
from pathlib import Path

import numpy as np
from programs import NO_SHORT_FITS

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"


def main_of(name):
    return runpy.run_path(str(EXAMPLES / name))["main"]


def write_csv(path, seed):
    """A damper whose force grows with the root of speed and with current."""
    random = np.random.default_rng(seed)
    t = np.arange(3000) / 250.0
    x = 0.01 * np.sin(2 * np.pi * 3 * t) + 0.004 * np.sin(2 * np.pi * 7.3 * t + seed)
    v = np.gradient(x, t)
    i = 0.5 + 0.15 * np.sin(2 * np.pi * 0.7 * t)
    force = np.sign(v) * np.abs(v) ** 0.5 * (400 + 1500 * i) + 100 * v + random.normal(0, 3, len(t))
    columns = np.column_stack((t, x, i, force))
    np.savetxt(path, columns, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
    return str(path)


def test_logs_become_a_model_and_its_report(tmp_path, monkeypatch):
    monkeypatch.setattr(*NO_SHORT_FITS)
    files, out = [write_csv(tmp_path / f"{seed}.csv", seed) for seed in (1, 2)], tmp_path / "out"
    words = [files[0], "--out", str(out), "--validate", files[1], "--time", "3", "--starts", "1", "--no-band"]
    assert main_of("csv_to_model.py")(words) == 0
    rows = json.loads((out / "model.json").read_text())["provenance"]["cost_J_percent"]
    assert [row["recording"] for row in rows] == ["1", "2"] and rows[1]["J"] < 40.0
    assert "Does it fit?" in (out / "report.html").read_text()
    assert main_of("csv_to_model.py")(words) == 2  # replaces nothing


def test_a_model_in_a_loop_equals_the_batch_simulation():
    assert main_of("model_in_a_loop.py")(str(ROOT / "config/models/sample.json")) < 1e-6


def test_the_gap_of_a_simulator_is_friction(tmp_path):
    assert "caused by friction" in main_of("gap_of_a_simulator.py")(str(tmp_path / "gap"))
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "named"
