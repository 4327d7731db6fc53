import re
import xml.etree.ElementTree as ET

import pytest
from planted import FUZZY, NETWORK, SAMPLING, planted

from ces_identify.prepare.series import prepare
from ces_identify.report.page import write_report
from ces_identify.structures import model_section
from ces_identify.structures.auto import REASON
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.model import Model
from ces_observer.structures.polynomial import Polynomial, Term
from ces_report.shell import PageHead


def plain(markup):
    return re.sub(r"<[^>]*>", "", str(markup))


def test_a_network_shows_each_regressor_in_newtons():
    table = model_section(NETWORK, [], VALIDATION).table
    assert [plain(row[0]) for row in table.rows] == ["F(k−1)", "v(k)", "v(k−1)", "i(k−3)"]
    assert [plain(cell) for cell in table.rows[1][1:]] == [
        "0",
        "0.3",
        "50",
        f"{500 * 0.25 * (1.2 * 2.0 + 0.7 * 1.5):.4g}",
    ]


def test_rules_are_named_by_their_memberships():
    table = model_section(FUZZY, [], VALIDATION).table
    assert [plain(row[0]) for row in table.rows] == ["v(k) = −0.4 m/s", "v(k) = 0.4 m/s"]
    assert [plain(cell) for cell in table.rows[0][1:]] == ["−200", "400", "50", "25", "−25"]


@pytest.mark.parametrize(("model", "rows"), [(NETWORK, 4), (FUZZY, 2)])
def test_the_page_is_whole_and_shows_the_table_in_place_of_terms(model, rows, tmp_path):
    write_report(
        tmp_path / "r.html",
        PageHead("A model"),
        model,
        evaluate(model, [prepare(planted(model, 1), SAMPLING)], VALIDATION),
    )
    root = ET.fromstring((tmp_path / "r.html").read_text(encoding="utf-8"))
    sections = {s.get("id"): s for s in root.iter("{http://www.w3.org/1999/xhtml}section")}
    assert "terms" not in sections
    assert len(list(sections["parameters"].iter("{http://www.w3.org/1999/xhtml}tr"))) == rows + 1
    assert model.size in " ".join(root.itertext())


@pytest.mark.parametrize(
    ("hydraulic", "advised", "reason"), [(2.0, True, ""), (4.9, False, "the mean of both is taken")]
)
def test_the_page_compares_structures_and_names_a_clearly_better_one(hydraulic, advised, reason, tmp_path):
    selection = {
        "structure": "polynomial",
        "structures": {"hydraulic": hydraulic, "polynomial": 5.0},
        REASON: reason,
    }
    body = Polynomial((Term(-1.5, ()),))
    model = Model(SAMPLING, body, NETWORK.envelope, (-1, 1), provenance={"selection": selection})
    write_report(tmp_path / "r.html", PageHead("A model"), model, [])
    root = ET.fromstring((tmp_path / "r.html").read_text(encoding="utf-8"))
    section = next(s for s in root.iter("{http://www.w3.org/1999/xhtml}section") if s.get("id") == "structures")
    rows = [["".join(cell.itertext()) for cell in row] for row in section.iter("{http://www.w3.org/1999/xhtml}tr")]
    assert rows[1:] == [["hydraulic", f"{hydraulic:.2f}"], ["polynomial", "5.00"]]
    assert ("model_hydraulic.json --structure hydraulic" in "".join(root.itertext())) == advised
    assert reason in "".join(section.itertext())


def test_a_model_without_a_comparison_has_no_such_section(tmp_path):
    model = Model(SAMPLING, Polynomial((Term(-1.5, ()),)), NETWORK.envelope, (-1, 1))
    write_report(tmp_path / "r.html", PageHead("A model"), model, [])
    assert 'id="structures"' not in (tmp_path / "r.html").read_text(encoding="utf-8")
