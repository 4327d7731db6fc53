"""Folders, globs and bags on the command lines of the programs that read recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tiny_bags as tiny
from programs import error_line

from ces import Recording
from ces_cli.main import main
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import with_distinct_names
from ces_data.bags.find import find_bag, find_bags
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError

ROOT = Path(__file__).resolve().parents[3]
MODEL, BAGS = ROOT / "config" / "models" / "sample.json", ROOT / "bags"


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name in ("one", "two", "deep/three"):
        tiny.write(tmp_path / name, tiny.drive())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_bag_that_is_named_twice_is_returned_once_or_as_often(here):
    words = ["one", "*", "deep"]
    assert [str(path) for path in find_bags(words)] == ["one", "deep/three", "two"]
    assert [str(path) for path in find_bags(words, repeated=True)] == ["one", "deep/three", "one", "two", "deep/three"]


def test_recordings_of_one_name_are_distinguished_by_their_paths():
    paths = [Path("fleet/red/road"), Path("fleet/blue/road"), Path("bench/noise")]
    named = with_distinct_names({path: Recording(path.name, {}) for path in paths})
    assert [recording.name for recording in named.values()] == ["red_road", "blue_road", "bench_noise"]
    alone = {path: Recording(path.name, {}) for path in paths[1:]}
    assert with_distinct_names(alone) == alone


def test_one_bag(here):
    assert find_bag("deep") == Path("deep/three")
    with pytest.raises(CesError, match=r"^\.: names 3 recordings \(deep/three, one, two\); expected one$"):
        find_bag(".")


def test_the_folder_of_a_killed_recorder_is_a_bag(here):
    (here / "one" / "metadata.yaml").unlink()
    assert find_bags(["one"]) == [Path("one")]
    (here / "one" / "one.mcap").rename(here / "one" / "one_0.mcap")
    assert find_bags(["*"]) == [Path("deep/three"), Path("one"), Path("two")]
    (here / "one" / "other.mcap").touch()  # a collection of bags
    assert find_bags(["one"]) == [Path("one/one_0.mcap"), Path("one/other.mcap")]


@pytest.mark.parametrize("name", ["x.csv", "x.mat", "x.MF4", "x.parquet", "x.blf", "x.asc", "x.log"])
def test_another_log_is_read_as_such(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    Path(name).touch()
    assert name in (line := error_line(capsys, "info", name)) and "bag" not in line


def test_every_program_takes_a_log_and_says_what_it_took_of_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = Recording.load(ROOT / "bags/sine_4hz").part(0.0, 4.0)
    t = 1e-9 * (recording.channel("position").stamps_ns - recording.channel("position").stamps_ns[0])
    x, current = recording.channel("position").values, np.full(len(t), 0.5)
    force = np.interp(t, np.linspace(0.0, t[-1], len(recording.channel("force"))), recording.channel("force").values)
    head, columns = "time_s,stroke_mm,current_A,force_N", np.column_stack([t, 1e3 * x, current, force])
    np.savetxt("rig.csv", columns, delimiter=",", header=head, comments="")
    np.savetxt("car.csv", columns[:, :3], delimiter=",", header=head.rpartition(",")[0], comments="")
    for words in (
        ["validate", str(MODEL), "rig.csv"],
        ["info", "rig.csv"],
        ["characterise", "rig.csv", "--out", "shown"],
    ):
        assert main(words) == 0
        assert "rig.csv: time from 'time_s' [s], position from 'stroke_mm' [mm to SI]" in capsys.readouterr().err
    assert main(["simulate", "--sim", str(MODEL), "car.csv", "--out", "force.csv"]) == 0
    assert "force from" not in capsys.readouterr().err and len(Path("force.csv").read_text().splitlines()) == len(t) + 1
    assert "car.csv: force: nothing is named like it" in error_line(capsys, "validate", str(MODEL), "car.csv")


def test_a_glob_finds_logs_and_a_folder_of_them_is_pointed_to_import(tmp_path):
    (tmp_path / "run.csv").touch()
    assert find_bags([str(tmp_path / "*.csv")]) == [tmp_path / "run.csv"]
    with pytest.raises(
        CesError, match=r"run.csv is a CSV table, not a rosbag2 bag; convert it: ces import \S+/run.csv --out BAG"
    ):
        find_bags([str(tmp_path)])


def test_programs_take_folders_and_globs(here, capsys):
    assert main(["info", ".", "--json"]) == 0
    assert capsys.readouterr().out.count('"sha256"') == 3
    assert main(["validate", str(MODEL), str(BAGS / "s*")]) == 0
    out = capsys.readouterr().out
    named = {line.split()[0] for line in out.splitlines() if line.split()}
    assert {"sine_4hz", "sweep"} <= named and "noise" not in named
    words = ["identify", str(BAGS / "n*"), "--validate", str(BAGS / "sine_*"), "--out", "m.json", "--rate", "1e5"]
    assert main(words) == 2
    assert "--rate 100000: the positions in noise are at 1000 Hz" in capsys.readouterr().err


def test_a_folder_with_a_file_that_lost_its_end_is_a_bag_whatever_its_name(here):
    whole = next((here / "one").glob("*.mcap")).read_bytes()
    for name, files in {
        "killed": {"run_0.mcap": whole[:-100]},
        "two_parts": {"run_0.mcap": whole, "run_1.mcap": whole[:-100]},
        "several": {"a.mcap": whole, "b.mcap": whole[:-100]},
        "ended": {"run_0.mcap": whole},
    }.items():
        (here / name).mkdir()
        for file, content in files.items():
            (here / name / file).write_bytes(content)
    assert find_bags(["killed", "two_parts"]) == [Path("killed"), Path("two_parts")]
    assert find_bags(["several"]) == [Path("several/a.mcap"), Path("several/b.mcap")]
    assert find_bags(["ended"]) == [Path("ended/run_0.mcap")]


def test_signals_are_proposed_for_what_a_killed_recorder_left(here, capsys):
    file = next((here / "one").glob("*.mcap"))
    (here / "killed").mkdir()
    (here / "killed" / "run_0.mcap").write_bytes(file.read_bytes()[:-100])
    assert main(["signals", "killed"]) == 0
    assert "joint_states" in capsys.readouterr().out


def test_a_part_is_all_that_a_program_sees_and_what_is_left_out_is_said(tmp_path, capsys):
    path = ROOT / "bags/sine_4hz"
    whole = Recording.load(path)
    taken = terminal.read_one(path, load_signals(), terminal.FORCE, (1.0, 3.0))
    assert taken.duration_s == pytest.approx(2.0, abs=0.01) and taken.name == "sine_4hz 1-3 s" and not taken.sha256
    assert f"sine_4hz: used from 1 s to 3 s; {whole.duration_s - 2.0:.1f} of" in capsys.readouterr().err
    both = with_distinct_names({path: taken, tmp_path / "sine_4hz": taken})
    names = [one.name for one in both.values()]
    assert len(set(names)) == 2 and all(name.endswith(" 1-3 s") for name in names)
