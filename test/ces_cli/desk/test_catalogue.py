"""The list of a folder: every kind with its facts, what cannot be read by name, thousands of files in a blink."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest
from served_folders import described_model, fill_folder

from ces_cli.desk import items
from ces_cli.desk.catalogue import Catalogue, Listing, ServedFolder


def look(folder: Path) -> Listing:
    return Catalogue(ServedFolder(folder)).listing()


def problems(folder: Path) -> dict[str, str]:
    return {one.path: one.problem for one in look(folder).of_kind(items.UNREADABLE)}


def test_every_kind_is_found_with_its_facts(tmp_path: Path) -> None:
    listing = look(fill_folder(tmp_path))
    assert {kind: len(listing.of_kind(kind)) for kind in items.KINDS if kind} == {
        items.MODEL: 6, items.RESULT: 5, items.REPORT: 2, items.RECORDING: 1, items.UNREADABLE: 0
    }  # fmt: skip
    model = listing.find(items.MODEL, "first.json")
    assert model is not None
    assert [model.facts[key] for key in ("cost_J", "size")] == [4.0, "3 terms"]
    assert str(model.facts["tests"]).startswith("sine_4hz (sha256 ")
    assert model.facts["certificate"].startswith("contraction")
    summaries = {one.facts.get("what", one.kind): one.summary for one in listing.outermost()}
    assert summaries["campaign"] == "2 models, 1 failed: polynomial"
    assert summaries["fleet"] == "2 units: 1 named"
    assert summaries["iteration"] == "2 iterations, 30 s recorded, J 9.00 % on the last fresh recording"
    assert summaries[items.RECORDING].startswith("20.0 s, ")
    assert "friction" in summaries["diagnosis"]


def test_files_that_cannot_be_read_are_named_with_the_reason(tmp_path: Path) -> None:
    text = described_model().to_json()
    (tmp_path / "half.json").write_text(text[: len(text) // 2])
    (tmp_path / "binary.json").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "empty.json").write_text("")
    (tmp_path / "huge.json").write_text(text[:-2] + " " * 9_000_000 + "}")
    (tmp_path / "model.json").write_text('{"a": 1}')
    (tmp_path / "keys.json").write_text('{"schema": "ces-model/1", "structure": "polynomial_narx", "terms": 3}')
    (tmp_path / "types.json").write_text('{"schema": "ces-gap/1", "gap": 3, "composition": {"gap_after_N": 1}}')
    (tmp_path / "null.json").write_bytes(b'{"schema": "ces-model/1"\0}')
    (tmp_path / "deep.json").write_text('{"schema": "ces-model/1", "a":' + "[" * 100_000)
    for name, lines in (("results.jsonl", "{}\n"), ("fleet.jsonl", "no json\n"), ("iterations.jsonl", "[1]\n")):
        (tmp_path / name).write_text(lines)
    found = problems(tmp_path)
    assert set(found) == {path.name for path in tmp_path.iterdir()}
    assert found["half.json"].startswith("not complete JSON")
    assert found["huge.json"] == "larger than 8 MB"
    assert found["empty.json"] == "empty"
    assert found["model.json"] == found["binary.json"] == "no schema of ces_observer at its beginning"
    assert found["null.json"].startswith("not complete JSON")
    assert found["fleet.jsonl"].startswith("line 1: not complete JSON")
    assert found["iterations.jsonl"] == "line 1: not a JSON object"
    assert found["results.jsonl"].startswith("line[0]: key 'status' is missing; expected a text")
    assert found["keys.json"].startswith("content: key 'certificate' is missing")
    assert "sentence" in found["types.json"]


def test_files_of_other_programs_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "package.json").write_text('{"name": "x"}')
    (tmp_path / "page.html").write_text("<title>other</title>")
    (tmp_path / "notes.txt").write_text("text")
    os.mkfifo(tmp_path / "pipe.json")  # opening it would wait for ever
    (tmp_path / "results.json").mkdir()
    listing = look(tmp_path)
    assert [(one.path, one.problem) for one in listing.items] == [("pipe.json", "not a regular file")]


def test_an_incomplete_last_line_is_one_that_is_being_written(tmp_path: Path) -> None:
    folder = fill_folder(tmp_path, bags=False)
    with (folder / "sizes" / "results.jsonl").open("a") as file:
        file.write('{"key": "dd44", "sta')
    campaign = look(folder).find(items.RESULT, "sizes/results.jsonl")
    assert campaign is not None and campaign.summary.startswith("2 models")


def test_links_that_leave_the_folder_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    described_model().save(tmp_path / "other" / "secret.json")
    root = tmp_path / "root"
    root.mkdir()
    (root / "a.json").symlink_to(tmp_path / "other" / "secret.json")
    (root / "folder").symlink_to(tmp_path / "other")
    (root / "loop").symlink_to(root)
    assert look(root).items == ()


def test_a_changed_file_is_read_again_and_others_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_cli.desk.catalogue.FRESH_S", 0.0)
    monkeypatch.setattr("ces_cli.desk.catalogue.WALKS", 0.0)
    described_model(4.0).save(tmp_path / "a.json")
    described_model(4.0).save(tmp_path / "b.json")
    catalogue = Catalogue(ServedFolder(tmp_path))
    before = {one.path: one for one in catalogue.listing().items}
    described_model(5.0).save(tmp_path / "a.json")
    after = {one.path: one for one in catalogue.listing().items}
    assert after["b.json"] is before["b.json"]
    assert after["a.json"].facts["cost_J"] == 5.0
    (tmp_path / "a.json").unlink()
    assert [one.path for one in catalogue.listing().items] == ["b.json"]


def test_a_folder_that_is_gone_is_said_to_be_gone(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    described_model().save(folder / "a.json")
    catalogue = Catalogue(ServedFolder(folder))
    assert (len(catalogue.listing().items), catalogue.listing().problem) == (1, "")
    folder.rename(tmp_path / "moved")
    gone = catalogue.listing(anew=True)
    assert (gone.items, gone.problem) == ((), "the folder cannot be read now: No such file or directory")
    (tmp_path / "moved").rename(folder)
    assert (len(catalogue.listing(anew=True).items), catalogue.listing().problem) == (1, "")


def test_a_folder_inside_that_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def scan(folder: Path) -> Any:
        if folder.name == "refuses":  # also for root, whom no permission stops
            raise PermissionError(errno.EACCES, "Permission denied")
        return list_folder(folder)

    list_folder = os.scandir
    (tmp_path / "refuses").mkdir()
    monkeypatch.setattr(os, "scandir", scan)
    assert problems(tmp_path) == {"refuses": "the folder cannot be read: Permission denied"}


def test_depth_and_number_of_files_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_cli.desk.catalogue.MAX_DEPTH", 2)
    described_model().save(tmp_path / "a.json")
    deep = tmp_path / "1" / "2" / "3"
    deep.mkdir(parents=True)
    described_model().save(deep / "b.json")
    (tmp_path / "z").mkdir()
    described_model().save(tmp_path / "z" / "c.json")
    listing = look(tmp_path)
    assert listing.cut and {one.path for one in listing.items} == {"a.json", "z/c.json"}  # what follows is there
