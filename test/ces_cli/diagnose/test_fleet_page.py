"""The page of a fleet: self-contained, with links to all reports, and a reason for every dash."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from pages import XHTML, assert_self_contained

from ces_cli.diagnose.fleet import explain_dashes, write_page

RED: dict[str, Any] = {
    "name": "red", "status": "done", "folder": "units/red", "verdict": "named", "probability": 0.93,
    "effects": ["friction"], "gap_N": 40.0, "gap_after_N": 5.0, "shrink": 0.88, "sentence": "It lacks <friction>.",
}  # fmt: skip
GREEN = {
    **RED,
    "name": "green",
    "folder": "units/green",
    "verdict": "no_gap",
    "effects": [],
    "shrink": None,
    "gap_N": 4.0,
}
BROKEN: dict[str, Any] = {"name": "broken", "status": "failed", "reason": "bags/broken: no topic & no field"}


def test_the_page_links_to_every_report_and_loads_nothing(tmp_path: Path) -> None:
    write_page([GREEN, BROKEN, RED], tmp_path / "fleet.html")
    text = (tmp_path / "fleet.html").read_text(encoding="utf-8")
    assert_self_contained(text, ("units/red/report.html", "units/green/report.html"))
    rows = ["".join(row.itertext()) for row in ET.fromstring(text).iter(f"{XHTML}tr")][1:]
    assert [row[:3] for row in rows] == ["red", "gre", "bro"]  # the largest gap first, failures last
    assert "It lacks <friction>." in rows[0] and BROKEN["reason"] in rows[2]


def test_every_dash_has_a_reason() -> None:
    assert explain_dashes([RED, BROKEN]) == ""
    assert explain_dashes([RED, GREEN]) == "-: no effect was named, so there is no probability or shrink."
    assert "could not be computed" in explain_dashes([{**RED, "gap_after_N": None}])
