"""`ces characterise`: tables, JSON and a folder from bags; what cannot be known has a reason; mistakes are one line."""

import csv
import json

import numpy as np
import pytest
from dyno_recordings import recording_of, sine_motion

from ces_cli.main import main
from ces_identify.scripting.recording import with_methods

LAW = """import numpy as np

def force(time_s, position_m, current_A):
    return 900.0 * np.gradient(position_m, time_s)
"""


@pytest.fixture(scope="module")
def dyno(tmp_path_factory):
    """A folder with two bags: sines at two currents."""
    folder = tmp_path_factory.mktemp("dyno")
    t, x, v = sine_motion(duration_s=4.0)
    for current in (0.3, 0.6):
        made = recording_of(t, x, current, 2000.0 * current * v, 5.0, name="x")
        with_methods(made).save(folder / f"sine_{current}")
    return folder


def run(capsys, *words):
    status = main(["characterise", *map(str, words)])
    out, err = capsys.readouterr()
    return status, out, err


def test_tables_and_folder(dyno, tmp_path, capsys):
    status, out, _ = run(capsys, dyno, "--out", tmp_path / "out")
    assert status == 0
    assert "at least 97 % of its peak" in " ".join(out.split())
    assert "Work per cycle" in out
    assert "cannot know: the current has no steps" in out
    with (tmp_path / "out/work.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [round(float(r["current_A"]), 3) for r in rows] == [0.3, 0.6]
    assert [float(r["damping_Ns_m"]) for r in rows] == pytest.approx([600.0, 1200.0], rel=0.01)
    assert (tmp_path / "out/characteristics.html").read_text(encoding="utf-8").count("ces characterise") >= 1


def test_json_with_a_simulation(dyno, tmp_path, capsys, monkeypatch):
    (tmp_path / "my_law.py").write_text(LAW)
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, dyno / "sine_0.6", "--model", "my_law:force", "--json")
    document = json.loads(out)
    assert status == 0
    assert document["schema"] == "ces-characterise/1"
    assert document["sources"] == ["measured", "my_law:force"]
    measured, simulated = document["work"]
    assert measured["difference_J"] is None
    assert simulated["difference_J"] == pytest.approx(simulated["work_J"] - measured["work_J"])
    assert simulated["damping_Ns_m"] == pytest.approx(900.0, rel=0.01)


def test_the_sample_bags_show_any_motion_and_say_why_not_more(capsys):
    status, out, _ = run(capsys, "bags/noise", "bags/sine_4hz", "--json")
    document = json.loads(out)
    assert status == 0
    assert document["peak_velocity"] == []
    assert {o["recording"] for o in document["omissions"] if o["subject"] == "cycles"} == {"noise", "sine_4hz"}
    assert any("no cycle repeats" in o["reason"] for o in document["omissions"])
    assert len(document["speed_bins"]) > 40
    assert np.ptp([b["median_N"] for b in document["speed_bins"]]) > 2000.0


def test_an_existing_folder_is_kept(dyno, tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    status, out, err = run(capsys, dyno, "--out", tmp_path)
    assert (status, out) == (2, "")
    assert "--overwrite" in err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
    assert run(capsys, dyno, "--out", tmp_path, "--overwrite")[0] == 0
    assert (tmp_path / "mine.txt").read_text() == "mine"
