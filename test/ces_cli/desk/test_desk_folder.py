"""What a folder holds, in lines: every kind, what cannot be read, what anyone may have put there; and uploads."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from diagnoses import named
from served_folders import described_model, fill_folder

from ces_cli.desk import folder as room
from ces_cli.desk.folder import RefusedError, ServedFolder
from ces_gap.report.gap_json import write_gap


def lines(folder: Path) -> dict[str, str]:
    return {item.path: item.text for item in ServedFolder(folder).items()}


def test_every_kind_is_found_and_says_what_it_is(tmp_path: Path) -> None:
    found = lines(fill_folder(tmp_path))
    assert set(found) == {"first.json", "second.json", "first.html", "worn/report.html", "recordings/sine_4hz"}
    assert found["first.json"] == "polynomial, J 4.00 % on sine_4hz"  # costs of other recordings do not compare
    assert found["first.html"] == "Model first.json"
    assert "friction" in found["worn/report.html"]  # the sentence of its gap.json
    assert found["recordings/sine_4hz"].endswith(" MB")


def test_tables_of_results_and_files_of_other_programs_are_no_recordings(tmp_path: Path) -> None:
    fill_folder(tmp_path)
    (tmp_path / "worn" / "next_experiment.csv").write_text("time_s,position_m\n")
    (tmp_path / "package.json").write_text('{"name": "x"}')
    (tmp_path / "page.html").write_text("<title>other</title>")
    (tmp_path / "notes.pdf").write_text("text")
    os.mkfifo(tmp_path / "pipe.json")  # opening it would wait for ever
    assert len(lines(tmp_path)) == 5
    (tmp_path / "rig.csv").write_text("time_s,position_m\n")
    assert len(lines(tmp_path)) == 6
    (tmp_path / "sizes").mkdir()
    (tmp_path / "sizes" / "results.csv").write_text("key,status\n")
    assert lines(tmp_path)["sizes/results.csv"] == "campaign"


def test_files_that_cannot_be_read_say_why(tmp_path: Path) -> None:
    text = described_model().to_json()
    (tmp_path / "half.json").write_text(text[: len(text) // 2])
    (tmp_path / "huge.json").write_text(text[:-2] + " " * 9_000_000 + "}")
    (tmp_path / "keys.json").write_text('{"schema": "ces-model/1", "terms": 3}')
    (tmp_path / "types.json").write_text('{"schema": "ces-model/1", "structure": 3, "provenance": [1]}')
    (tmp_path / "deep.json").write_text('{"schema": "ces-model/1", "a":' + "[" * 100_000)
    items = ServedFolder(tmp_path).items()
    assert {item.path for item in items if item.is_wrong} == {path.name for path in tmp_path.iterdir()}
    assert next(item.text for item in items if item.path == "huge.json") == "cannot be read: larger than 8 MB"


def write_sentence(folder: Path) -> None:
    fill_folder(folder)
    write_gap(folder / "worn" / "gap.json", named())
    content = json.loads((folder / "worn" / "gap.json").read_text())
    (folder / "worn" / "gap.json").write_text(json.dumps({**content, "sentence": "\udce9"}))


HOSTILE: dict[str, Callable[[Path], object]] = {
    "half a character": write_sentence,
    "infinite cost": lambda folder: (folder / "a.json").write_text(
        described_model(1.0).to_json().replace("1.0", "1e999")
    ),
    "name that is not UTF-8": lambda folder: Path(os.fsdecode(os.fsencode(folder) + b"/caf\xe9.csv")).write_text(""),
    "name with a tag": lambda folder: (folder / "<img src=x onerror=alert(1)>.mcap").write_bytes(b""),
    "time of no calendar": lambda folder: os.utime(fill_folder(folder) / "first.json", (1e11, 1e11)),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_the_page_of_a_hostile_folder_is_shown(name: str, tmp_path: Path) -> None:
    pytest.importorskip("flask", reason="Flask is not installed")
    from served_folders import open_desk

    HOSTILE[name](tmp_path)
    _, client = open_desk(tmp_path)
    page = client.get("/")
    assert page.status_code == 200 and "<img" not in page.text


@pytest.mark.parametrize("path", [".hidden.html", "..", "", "/etc/passwd", "sub/\0", "x" * 5000, "outside/secret.html"])
def test_there_is_no_way_out_of_the_folder(tmp_path: Path, path: str) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (tmp_path / "secret.html").write_text("secret")
    (root / ".hidden.html").write_text("secret")
    (root / "outside").symlink_to(tmp_path)
    described_model().save(tmp_path / "secret.json")
    (root / "linked.json").symlink_to(tmp_path / "secret.json")
    (root / "loop").symlink_to(root)
    assert lines(root) == {}
    with pytest.raises(RefusedError):
        ServedFolder(root).find(path)


def test_depth_and_number_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "MAX_DEPTH", 2)
    monkeypatch.setattr(room, "MAX_ITEMS", 2)
    (tmp_path / "1" / "2" / "3").mkdir(parents=True)
    (tmp_path / "1" / "2" / "3" / "deep.csv").write_text("")
    assert lines(tmp_path) == {}
    for name in "abc":
        (tmp_path / f"{name}.csv").write_text("")
    assert len(lines(tmp_path)) == 2


def receive(folder: Path, name: str, content: bytes = b"1,2\n", size: int | None = 4) -> str:
    return ServedFolder(folder).receive(name, size, io.BytesIO(content))


@pytest.mark.parametrize(
    ("sent", "kept"),
    [("rig.csv", "rig.csv"), ("../../a b.csv", "a b.csv"), ("C:\\logs\\-x*.CSV", "x_.CSV"), (".bag.mcap", "bag.mcap")],
)
def test_uploads_keep_a_plain_name_in_the_folder(tmp_path: Path, sent: str, kept: str) -> None:
    assert receive(tmp_path, sent) == kept
    assert [path.name for path in tmp_path.iterdir()] == [kept]
    assert (tmp_path / kept).read_bytes() == b"1,2\n"


def test_uploads_that_cannot_be_kept_are_refused_and_leave_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "old.csv").write_text("old")
    for status, name, size in (
        (409, "old.csv", 4),
        (415, "run.py", 4),
        (415, "a.html", 4),
        (413, "a.csv", None),
        (400, "a.csv", 9),
    ):
        with pytest.raises(RefusedError) as caught:
            receive(tmp_path, name, size=size)
        assert caught.value.status == status
    monkeypatch.setattr(room, "MIN_FREE_BYTES", 1 << 60)
    with pytest.raises(RefusedError, match="no room"):
        receive(tmp_path, "a.csv")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("old.csv", "old")]
