"""One rule for all outputs: nothing that exists is replaced without --overwrite, no input ever, all before the work."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from ces_cli.terminal.outputs import name_report
from ces_data.outputs import OUT, require_folder, require_outputs
from ces_observer.errors import CesError, OptionName
from ces_observer.json_text import write_atomically

ROOT = Path(__file__).resolve().parents[3]
MODEL, ROAD, NOISE = ROOT / "config" / "models" / "sample.json", ROOT / "bags" / "road", ROOT / "bags" / "noise"
REPLACE = "or replace it with --overwrite"
RAW = "time_s,position_m,current_A,force_N\n0.0,0.001,0.5,120.0\n"


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
    require_outputs(overwrite, {OUT: path})


def require_new_bag(path, overwrite):
    require_outputs(overwrite, bags={OUT: path})


def refusal(check, *arguments):
    with pytest.raises(CesError) as caught:
        check(*arguments)
    return caught.value.word(OptionName.as_flag)


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
    (here / "lost").symlink_to("nowhere")
    assert refusal(require_new_file, Path("lost"), False) == expected.replace("taken", "lost")
    for overwrite in (False, True):
        assert "full: is a folder" in refusal(require_new_file, Path("full"), overwrite)
        assert "the folder none does not exist; make it first" in refusal(require_new_file, Path("none/x"), overwrite)
        assert "/dev/null: is a device" in refusal(require_new_file, Path("/dev/null"), overwrite)


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


def test_a_file_that_is_replaced_keeps_its_mode(here):
    (here / "taken").chmod(0o600)
    write_atomically(here / "taken", "new")
    write_atomically(here / "fresh", "new")
    assert [(here / name).stat().st_mode & 0o777 for name in ("taken", "fresh")] == [0o600, 0o644]
