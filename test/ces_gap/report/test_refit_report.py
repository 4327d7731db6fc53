"""The refits of a model's parameters in gap.json, on the page and in the sentence."""

from dataclasses import replace

from diagnoses import named
from schema_rules import SCHEMA, faults

from ces_gap.diagnosis import AMBIGUOUS, format_verdict
from ces_gap.refit import GroupRefit, ModelRefits, QuantityChange
from ces_gap.report.gap_json import gap_document
from ces_gap.report.page import report_page

CHANGE = QuantityChange("Friction of the seals [N]", 12.0, 24.5)
REFIT = GroupRefit("friction", ("friction",), 9.25, -0.5, 0.61, 0.85, 0.04, (CHANGE,), (0.4, 0.45))
REFITTED = replace(
    named(),
    refits=ModelRefits((REFIT, replace(REFIT, group="valve lag", energy=0.01)), (("friction",), ("valve_lag",))),
    refit_finding="the refit of the model's friction agrees: closes 61% of the held-out gap",
)


def test_gap_json_has_the_refits_without_their_blocks():
    document = gap_document(REFITTED)
    assert faults(document, SCHEMA, SCHEMA) == []
    first = document["witness"]["refits"][0]
    assert first["moved_z"] == 9.25 and first["changes"][0]["after"] == 24.5 and "block_energy" not in first
    assert gap_document(named())["witness"] is None


def test_the_page_shows_what_moved_and_leaves_out_what_closes_nothing():
    page = report_page(REFITTED)
    assert "The refit of the model" in page and "Friction of the seals [N]: 12" in page and "9.2" in page
    assert "<td>Valve lag</td>" not in page
    assert "Second check" not in report_page(named())


def test_disagreement_is_the_doubt_where_there_is_no_other():
    says = "a refit of the model's valve lag explains more: closes 80% of the held-out gap"
    alone = tuple(replace(cause, probability=0.0) for cause in REFITTED.causes)
    text = format_verdict(replace(REFITTED, verdict=AMBIGUOUS, indistinguishable=(), causes=alone, refit_finding=says))
    assert text.startswith("A refit of the model's valve lag explains more: closes 80%")
