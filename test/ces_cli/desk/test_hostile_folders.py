"""Folders that anyone may have filled: no file, name or time in them takes a page down."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import os
import re
from collections.abc import Callable
from pathlib import Path

from diagnoses import named

from ces_cli.desk.app import Site, make_app
from ces_cli.desk.items import Item
from ces_gap.report.gap_json import write_gap

HUGE = "1" + "0" * 400  # a whole number that no float holds


def write_diagnosis(key: str, value: str) -> Callable[[Path], object]:
    """Return what writes a diagnosis with another JSON text for a key."""

    def write(folder: Path) -> None:
        write_gap(folder / "gap.json", named())
        text = (folder / "gap.json").read_text(encoding="utf-8")
        (folder / "gap.json").write_text(re.sub(rf'"{key}": [^,\n]*', lambda _: f'"{key}": {value}', text, count=1))

    return write


def write_metadata(folder: Path) -> None:
    (folder / "bag").mkdir()
    (folder / "bag" / "metadata.yaml").write_text(f"info:\n  duration:\n    nanoseconds: {HUGE}\n")


HOSTILE: dict[str, Callable[[Path], object]] = {
    "infinite number": write_diagnosis("rms_N", "1e999"),
    "number beyond floats": write_diagnosis("cost_J", HUGE),
    "half a character": write_diagnosis("sentence", r'"\udce9"'),
    "duration beyond floats": write_metadata,
    "name that is not UTF-8": lambda folder: Path(os.fsdecode(os.fsencode(folder) + b"/caf\xe9")).mkdir(),
    "name with a tag": lambda folder: (folder / "<script>alert(1)<\nscript>.mcap").write_bytes(b""),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_every_page_of_a_hostile_folder_is_shown(name: str, tmp_path: Path) -> None:
    HOSTILE[name](tmp_path)
    client = make_app(Site(tmp_path), "127.0.0.1").test_client()
    overview = client.get("/")
    links = set(re.findall(r'href="(/(?:view|list)[^"]*)"', overview.text))
    assert {path: client.get(path).status_code for path in ("/", *links)} == dict.fromkeys(("/", *links), 200)
    assert "<script>alert" not in overview.text


def test_a_time_that_no_calendar_has_is_a_dash() -> None:
    assert {Item("model", "a.json", time_s).changed for time_s in (1e15, -1e12, float("inf"), float("nan"))} == {"–"}
