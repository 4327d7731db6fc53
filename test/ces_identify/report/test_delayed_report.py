"""The report on a file with two models: known at once, and after a delay."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
from report_examples import TERMS, damper, model

from ces_identify.report.page import write_report
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.structures.polynomial import Polynomial

XHTML, SVG = "{http://www.w3.org/1999/xhtml}", "{http://www.w3.org/2000/svg}"


def words(element: ET.Element) -> str:
    return " ".join("".join(element.itertext()).split())


def test_it_has_a_row_and_sections_for_each_delay(tmp_path: Path) -> None:
    late = model(sampling=replace(model().sampling, delay_s=0.006), body=Polynomial(TERMS[:2]))
    two, series = model(delayed=late), [damper("sine", seed=1), damper("road", seed=2)]
    found = [e for s in series for m in two.each for e in evaluate(m, [s], VALIDATION)]
    write_report(tmp_path / "report.html", "A file", two, found, {})
    root = ET.fromstring((tmp_path / "report.html").read_text(encoding="utf-8"))
    idents = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(idents) == len(set(idents)) and len(list(root.iter(f"{SVG}svg"))) == 3 * len(found) + 5
    sections = {e.get("id"): e for e in root.iter(f"{XHTML}section")}
    rows = [[words(cell) for cell in row.iter(f"{XHTML}td")] for row in sections["costs"].iter(f"{XHTML}tr")]
    rows = [row for row in rows if VALIDATION in row]
    assert [(row[0], row[2]) for row in rows] == [("sine", "0"), ("sine", "6"), ("road", "0"), ("road", "6")]
    assert [float(row[5]) for row in rows] == pytest.approx([e.cost for e in found], rel=6e-3)
    for ident in ("recordings", "terms", "coverage"):
        first, later = (words(next(sections[one].iter(f"{XHTML}h2"))) for one in (ident, f"{ident}-late"))
        assert later == f"{first} (6 ms later)"
    headline = words(next(root.iter(f"{XHTML}dd")))
    assert headline.startswith("Well. Validation, at once: cost J from ") and "; 6 ms later: cost J from " in headline
    assert "6 terms; 2 terms (6 ms later)" in words(root)
