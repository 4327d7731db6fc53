"""Folders that anyone may have filled: no file, name or time in them takes a page down."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path

from served_folders import STROKE

from ces_serve.app import Site, make_app
from ces_serve.items import Item

HUGE = "1" + "0" * 400  # a whole number that no float holds
START = {"seed": 1, "cost": 3.0, "size": 3, "ended": "running", "elapsed_s": 1.0}


def write_stroke(changed: Mapping[str, str]) -> Callable[[Path], object]:
    """Return what writes a learned stroke with other JSON texts for some keys."""

    def write(folder: Path) -> None:
        text = json.dumps(STROKE)
        for key, value in changed.items():
            text = re.sub(rf'"{key}": [^,]*', lambda _, k=key, v=value: f'"{k}": {v}', text, count=1)
        (folder / "result.json").write_text(text)

    return write


def write_progress(head: Mapping[str, object], *rows: str) -> Callable[[Path], object]:
    """Return what writes the progress file of a program that runs on another computer."""
    first = {"schema": "ces-progress/1", "program": "identify", "host": "elsewhere", **head}
    return lambda folder: (folder / ".model.json.progress").write_text("\n".join([json.dumps(first), *rows]) + "\n")


def write_metadata(folder: Path) -> None:
    (folder / "bag").mkdir()
    (folder / "bag" / "metadata.yaml").write_text(f"info:\n  duration:\n    nanoseconds: {HUGE}\n")


HOSTILE: dict[str, Callable[[Path], object]] = {
    "infinite count": write_stroke({"iterations": "1e999"}),
    "number beyond floats": write_stroke({"first_error_m": HUGE}),
    "half a character": write_stroke({"stopped": r'"\udce9"'}),
    "duration beyond floats": write_metadata,
    "cost beyond floats": write_progress({}, json.dumps(START).replace("3.0", HUGE)),
    "costs not finite": write_progress({}, json.dumps({**START, "cost": float("nan"), "elapsed_s": float("inf")})),
    "row without keys": write_progress({}, '{"seed": 1, "cost": 1}'),
    "seed that is a list": write_progress({}, json.dumps({**START, "seed": [1]})),
    "start that is no time": write_progress({"began_s": "noon"}),
    "half a character in a head": write_progress({"things": "\udce9", "program": "jobs"}),
    "name that is not UTF-8": lambda folder: Path(os.fsdecode(os.fsencode(folder) + b"/caf\xe9")).mkdir(),
    "name with a tag": lambda folder: (folder / "<script>alert(1)<\nscript>.mcap").write_bytes(b""),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_every_page_of_a_hostile_folder_is_shown(name: str, tmp_path: Path) -> None:
    HOSTILE[name](tmp_path)
    client = make_app(Site(tmp_path), "127.0.0.1").test_client()
    overview = client.get("/")
    links = set(re.findall(r'href="(/(?:view|search|list)[^"]*)"', overview.text))
    assert {path: client.get(path).status_code for path in ("/", *links)} == dict.fromkeys(("/", *links), 200)
    assert "<script>alert" not in overview.text


def test_a_name_that_is_not_text_is_listed_with_the_remedy(tmp_path: Path) -> None:
    for name in (b"caf\xe9.mcap", b"two\nlines.mcap", b"back\\slash.mcap", b"caf\xe9.txt"):
        Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + name)).write_bytes(b"")
    page = make_app(Site(tmp_path), "127.0.0.1").test_client().get("/list/unreadable").text
    for name in ("caf\ufffd.mcap", "two\ufffdlines.mcap", "back\ufffdslash.mcap"):
        assert name in page
    assert page.count("not plain UTF-8 text; rename it") == 3 and "1970" not in page
    assert "caf\ufffd.txt" not in page  # nothing of ours


def test_a_time_that_no_calendar_has_is_a_dash() -> None:
    assert {Item("model", "a.json", time_s).changed for time_s in (1e15, -1e12, float("inf"), float("nan"))} == {"–"}
