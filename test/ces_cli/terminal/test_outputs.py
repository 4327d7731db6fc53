"""One rule for all outputs: nothing that exists is replaced without --overwrite, no input ever, all before the work."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from ces_cli.main import main
from ces_cli.terminal.outputs import MAX_NAME, name_report, require_folder, require_outputs
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically

ROOT = Path(__file__).resolve().parents[3]
MODEL, ROAD, NOISE = ROOT / "config" / "models" / "sample.json", ROOT / "bags" / "road", ROOT / "bags" / "noise"
REPLACE = "or replace it with --overwrite"
RAW = "time_s,position_m,current_A,force_N\n0.0,0.001,0.5,120.0\n"
FOREIGN = "log.csv: not written by ces; it is not replaced: choose another name for --out, or delete it yourself"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a model and a log, a folder of something else, and an empty folder."""
    (tmp_path / "taken").write_text('{"schema": "ces-model/1"}')
    (tmp_path / "log.csv").write_text(RAW)
    shutil.copy(MODEL, tmp_path / "other.json")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("mine")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def require_new_file(path, overwrite):
    require_outputs(overwrite, {"--out": path})


def require_new_bag(path, overwrite):
    require_outputs(overwrite, bags={"--out": path})


def refusal(check, *arguments):
    with pytest.raises(CesError) as caught:
        check(*arguments)
    return str(caught.value)


def test_a_report_in_a_folder_says_which_simulation_and_recordings(here):
    folder = Path("empty")
    assert name_report(None, ["m"], ["a"]) is None
    assert name_report(Path("r.html"), ["m"], ["a"]) == Path("r.html")
    assert name_report(folder, ["model"], ["road", "sine 4/Hz"]) == folder / "model_on_road_and_sine-4-Hz.html"
    assert name_report(folder, ["a", "b"], list("cdefgh")) == folder / "a_and_b_on_c_and_d_and_e_and_f_and_2_more.html"
    assert name_report(folder, ["campaign"], []) == folder / "campaign.html"
    assert len(name_report(folder, ["m"], ["x" * 300]).name) < 140
    assert name_report(ROAD, ["m"], ["a"]) == ROAD  # a bag is no folder for reports


def test_files(here):
    require_new_file(None, False)
    require_new_file(Path("new"), False)
    require_new_file(Path("taken"), True)
    expected = f"taken: exists; choose another name for --out, {REPLACE}"
    assert refusal(require_new_file, Path("taken"), False) == expected
    (here / "link").symlink_to("log.csv")
    (here / "lost").symlink_to("nowhere")
    for overwrite in (False, True):
        for name in ("log.csv", "link", "lost"):
            assert refusal(require_new_file, Path(name), overwrite) == FOREIGN.replace("log.csv", name)
        assert "full: is a folder" in refusal(require_new_file, Path("full"), overwrite)
        assert "the folder none does not exist; make it first" in refusal(require_new_file, Path("none/x"), overwrite)
        assert "/dev/null: is a device" in refusal(require_new_file, Path("/dev/null"), overwrite)


def test_names_that_are_too_long_for_a_file_system(here):
    long = "\N{LATIN SMALL LETTER U WITH DIAERESIS}" * 125  # of two bytes each
    expected = "has 250 bytes; expected at most 240, choose a shorter one"
    assert expected in refusal(require_new_file, Path(long), False)
    assert expected in refusal(require_new_bag, Path(long) / "bag", False)
    assert expected in refusal(require_folder, Path(long))
    write_atomically(here / ("n" * MAX_NAME), "")
    require_new_file(Path("n" * MAX_NAME), True)


def test_bags_and_folders(here):
    for path in ("new", "empty", "deep/new"):
        require_new_bag(Path(path), False)
        require_folder(Path(path))
    require_folder(Path("full"))
    assert "is a folder but not a bag, so it is not replaced" in refusal(require_new_bag, Path("full"), True)
    assert "taken: is not a folder" in refusal(require_folder, Path("taken"))
    assert "taken is not a folder; expected a folder to write into" in refusal(require_folder, Path("taken/deep/x"))


def test_a_folder_that_cannot_be_written(here, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write anywhere
    assert "the folder . cannot be written".replace(".", str(here)) in refusal(require_new_file, Path("new"), False)
    assert "cannot be written" in refusal(require_folder, Path("deep/new"))


def test_a_disk_without_room_is_refused_before_the_work(here, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(total=9e9, free=2e6))
    require_new_file(Path("new"), False)  # a model
    line = "its disk has 2.0 MB of free space, for results of up to 4.0 MB; free space, or choose a folder on another"
    assert f"new: {line}" in refusal(require_folder, Path("new"))
    assert f"r.html: {line}" in refusal(require_outputs, False, {"--report": Path("r.html")})
    (here / "log.csv").write_bytes(bytes(3_000_000))
    copies = (None, {"--out": Path("new")}, None, [Path("log.csv")])
    assert f"new: {line}" in refusal(require_outputs, False, *copies)


def test_two_outputs_of_one_name_and_an_output_that_is_an_input(here):
    names = {"--out": Path("x"), "--report": Path("empty/../x")}
    assert "is named by --out and --report" in refusal(require_outputs, True, names)
    assert refusal(require_outputs, True, {"--out": Path("taken")}, None, None, [None, here / "taken"]) == (
        "taken: is an input, too; choose another name for --out"
    )
    (here / "bag").mkdir()
    (here / "bag" / "metadata.yaml").touch()
    inputs = [here / "bag" / "model.json"]
    assert "x.csv: is inside the input bag; choose another place for --out" in refusal(
        require_outputs, True, {"--out": Path("bag/x.csv")}, None, None, [Path("bag")]
    )
    assert "bag: is an input, too" in refusal(require_outputs, True, None, {"--out": Path("bag")}, None, inputs)
    require_outputs(
        False, names | {"--report": None}, {"--bag": Path("new")}, {"--dir": Path("empty")}, [Path("taken")]
    )


WRITERS = {  # by what they write: words of the program, and whether it is run, not only refused
    "x.csv": (f"simulate --sim {MODEL} {ROAD} --out x.csv", True),
    "x.c": (f"export {MODEL} --out x.c", True),
    "x.fmu": (f"export {MODEL} --sources-only --out x.fmu", True),
    "table.csv": (f"export-data {ROAD} --out table.csv", True),
    "x.parquet": (f"export-data {ROAD} --out x.parquet", True),
    "x.yaml": (f"signals {ROAD} --out x.yaml", True),
    "x.json": (f"identify {ROAD} --out x.json", False),
    "x.html": (f"validate {MODEL} {ROAD} --report x.html", False),
    "y.html": (f"compare {MODEL} other.json {ROAD} --report y.html", False),
    "played/log.csv": (f"replay {MODEL} {ROAD} --out played", True),
    "bag/log.csv": ("import log.csv --out bag", False),
    "rig/log.csv": ("rig sine_4hz --out rig", True),
    "dyno/characteristics.html": (f"characterise {ROAD} --out dyno", False),
    "gap/report.html": (f"diagnose --sim {MODEL} --real {ROAD} --out gap", False),
    "cases/cases/1/case.json": ("blind make --seed 1 --cases 1 --out cases", False),
    "x.ces": (f"export {MODEL} --out x.ces", True),
}


@pytest.mark.parametrize("name", WRITERS)
def test_overwrite_replaces_only_what_ces_wrote(here, capsys, name):
    words, is_run = WRITERS[name]
    foreign, written = here / name, here / name.partition("/")[0]
    foreign.parent.mkdir(parents=True, exist_ok=True)
    foreign.write_text(RAW)
    if foreign.name == "log.csv":
        (foreign.parent / "metadata.yaml").touch()
    assert main([*words.split(), "--overwrite"]) == 2
    assert "not written by ces; it is not replaced" in capsys.readouterr().err
    assert foreign.read_text() == RAW
    if is_run:
        shutil.rmtree(written) if written.is_dir() else written.unlink()
        assert main(words.split()) == 0
        assert main(words.split()) == 2
        assert REPLACE in capsys.readouterr().err  # said of what is replaced only
        assert name != "x.csv" or main([*words.split(), "--overwrite"]) == 0


def test_pages_models_and_tables_in_a_folder_of_ours_are_replaced(here, capsys):
    (here / "empty" / "report.html").write_text('<meta name="generator" content="ces_observer 1.0" />')
    (here / "empty" / "gap.csv").write_text("a,b")
    require_outputs(True, folders={"--out": Path("empty")}, names=("report.html", "gap.csv"))
    (here / "empty" / "report.html").unlink()
    assert "gap.csv: not written by ces" in refusal(
        lambda: require_outputs(True, folders={"--out": Path("empty")}, names=("report.html", "gap.csv"))
    )
    for writer in ("identify --campaign c.yaml", f"diagnose --sim {MODEL} --real {ROAD} --each recording"):
        (here / "full" / "results.csv").write_text(RAW)
        (here / "full" / "fleet.csv").write_text(RAW)
        assert main([*writer.split(), "--out", "full"]) == 2  # these go on without --overwrite
        assert "csv: not written by ces; it is not replaced" in capsys.readouterr().err
    require_new_bag(NOISE, True)  # of an older version: its metadata says who wrote it


def test_a_file_that_is_replaced_keeps_its_mode(here):
    (here / "taken").chmod(0o600)
    write_atomically(here / "taken", "new")
    write_atomically(here / "fresh", "new")
    assert [(here / name).stat().st_mode & 0o777 for name in ("taken", "fresh")] == [0o600, 0o644]
