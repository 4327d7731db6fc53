"""The pages of models, diagnoses, fleets, iterations and learned strokes: a file goes in, content comes out.

Every function raises CesError, OSError or one of WRONG_CONTENT if the file has changed to something else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from flask import url_for

from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_observer.model import Model, load_model
from ces_serve.files import item
from ces_serve.files.bounded_reading import read_json, read_rows
from ces_serve.files.facts import structure_name
from ces_serve.files.item import Item
from ces_serve.web import curves
from ces_serve.web.addresses import files_beside, view_url
from ces_serve.web.site import Site
from ces_serve.web.tables import PageCell, PageContent, PageTable, cell, join, number, upper_first

MIN_CAUSES, SHOWN_FROM = 4, 0.01  # causes in any case, and the probability of further ones


def model_content(where: Site, one: Item) -> PageContent:
    """Return the page of a model, checked as the observer checks it."""
    model = load_model(where.folder.find_file(one.path))
    content = PageContent(
        headline=f"{structure_name(model.structure)}, {model.size}. {upper_first(str(one.facts['certificate']))}."
    )
    content.facts = [
        ("rate", number(model.sampling.rate_Hz, "g", "Hz")),
        ("speed from", f"{model.sampling.differentiator}, {model.sampling.bandwidth_Hz:.4g} Hz"),
        ("identified on", join(one.facts["recordings"])),
        ("validated on", join(one.facts["validation"])),
        ("written by", str(model.provenance.get("tool", "–"))),
        *_envelope(model),
    ]
    costs = model.provenance.get("cost_J_percent") or []
    rows = [(PageCell(str(c["recording"])), PageCell(str(c["role"])), cell(c["J"], ".2f")) for c in costs]
    if rows:
        content.tables = [PageTable("Cost of a free run", ("recording", "role", "J %"), tuple(rows))]
    content.links = [("model file (JSON)", url_for("files.send", path=one.path))]
    return content


def diagnosis_content(where: Site, one: Item) -> PageContent:
    """Return the page of a diagnosis; its report says more."""
    found = read_json(where.folder.find_file(one.path))
    gap, causes = found["gap"], found["causes"]
    content = PageContent(headline=str(found["sentence"]), warnings=[str(note) for note in found.get("notes") or ()])
    content.facts = [
        ("verdict", str(found["verdict"]).replace("_", " ")),
        ("gap", number(gap["rms_N"], ".1f", "N RMS")),
        ("95 % interval", " to ".join(number(end, ".1f") for end in gap["ci95_N"]) + " N"),
        ("noise floor", number(gap["noise_floor_N"], ".1f", "N")),
        ("left after the repair", number(found["composition"]["gap_after_N"], ".1f", "N RMS")),
        ("simulation", str(found.get("simulation", "–"))),
    ]
    content.tables = _causes(causes)
    purpose = (found.get("next_experiment") or {}).get("purpose")
    if purpose:
        content.facts.append(("next experiment", str(purpose)))
    content.links = [
        *files_beside(where, one, ("report.html", "augmented.json")),
        ("gap.json", url_for("files.send", path=one.path)),
    ]
    return content


def fleet_content(where: Site, one: Item) -> PageContent:
    """Return the page of a fleet, largest gap first."""
    rows = read_rows(where.folder.find_file(one.path))
    rows.sort(key=lambda row: (row["status"] != DONE, -(row.get("gap_N") or 0.0)))
    content = PageContent(headline=one.summary, links=files_beside(where, one, ("fleet.html", "fleet.csv")))
    headings = ("unit", "verdict", "probability", "gap N", "after N", "says")
    content.tables = [PageTable("Units, largest gap first", headings, tuple(_unit(where, one, row) for row in rows))]
    return content


def iteration_content(where: Site, one: Item) -> PageContent:
    """Return the page of an iteration: how the costs fell with the recorded seconds."""
    rows = read_rows(where.folder.find_file(one.path))
    content = PageContent(headline=one.summary, charts=curves.iteration_chart(rows))
    headings = ("experiment", "s", "J % before it was used", "J % fit", "covered %", "model")
    content.tables = [PageTable("Iterations", headings, tuple(_iteration(where, one, row) for row in rows))]
    content.links = files_beside(where, one, ("report.html", "model.json", "plan.yaml"))
    return content


def stroke_content(where: Site, one: Item) -> PageContent:
    """Return the page of a learned stroke: the error of each run."""
    found = read_json(where.folder.find_file(one.path))
    content = PageContent(headline=one.summary, warnings=[str(text) for text in found.get("warnings") or ()])
    content.facts = [
        ("repeatability", number(1e3 * found["repeatability_m"], ".4f", "mm RMS")),
        ("bandwidth of learning", number(found["filter"]["bandwidth_Hz"], ".1f", "Hz")),
        ("stopped", str(found["stopped"])),
    ]
    content.charts = curves.stroke_chart(found["runs"], found["repeatability_m"])
    runs = tuple(
        (PageCell(str(n)), PageCell(str(run["kind"])), cell(run["error_m"], ".4f", 1e3), cell(run["gain"], "g"))
        for n, run in enumerate(found["runs"], start=1)
    )
    content.tables = [PageTable("Runs", ("run", "kind", "error mm RMS", "gain"), runs)]
    content.links = files_beside(where, one, ("report.html", "command.csv", "learned.yaml"))
    return content


def _envelope(model: Model) -> list[tuple[str, str]]:
    e = model.envelope
    named = (("position", e.position_m, "m"), ("speed", e.speed_m_s, "m/s"), ("current", e.current_A, "A"))
    rows = [(*one,) for one in (*named, ("force", model.force_envelope_N, "N"))]
    return [
        (f"{name} of the recordings", f"{number(r[0], '.4g')} to {number(r[1], '.4g')} {unit}")
        for name, r, unit in rows
    ]


def _causes(causes: Sequence[Mapping[str, Any]]) -> list[PageTable]:
    """Return the table of the causes, without the improbable ones after the first few."""
    shown = [cause for n, cause in enumerate(causes) if n < MIN_CAUSES or (cause["probability"] or 0.0) >= SHOWN_FROM]
    rows = tuple(
        (
            PageCell(str(c["effect"]).replace("_", " ")),
            cell(c["probability"], ".2f"),
            cell(c["gap_after_N"], ".1f"),
            cell(c["shrink"], ".0f", 100.0),
        )
        for c in shown
    )
    rest = len(causes) - len(shown)
    note = f"{rest} more effects with a probability below {SHOWN_FROM:g} are in the report." if rest else ""
    headings = ("effect alone", "probability", "gap after N", "shrink %")
    return [PageTable("Causes, most probable first", headings, rows, note)] if rows else []


def _unit(where: Site, one: Item, row: Row) -> tuple[PageCell, ...]:
    if row["status"] != DONE:
        return (
            PageCell(str(row["name"])),
            PageCell(str(row["status"])),
            *[PageCell("–", numeric=True)] * 3,
            PageCell(str(row["reason"])),
        )
    path = f"{one.folder}/{row['folder']}/gap.json".lstrip("/")
    listed = where.catalogue.listing().find(item.DIAGNOSIS, path)
    verdict = ": ".join(filter(None, (str(row["verdict"]), " + ".join(map(str, row["effects"]))))).replace("_", " ")
    return (
        PageCell(str(row["name"]), view_url(item.DIAGNOSIS, path) if listed else ""),
        PageCell(verdict),
        cell(row["probability"], ".2f"),
        cell(row["gap_N"], ".1f"),
        cell(row["gap_after_N"], ".1f"),
        PageCell(str(row["sentence"])),
    )


def _iteration(where: Site, one: Item, row: Row) -> tuple[PageCell, ...]:
    path = f"{one.folder}/{row['model']}".lstrip("/")
    listed = where.catalogue.listing().find(item.MODEL, path)
    return (
        PageCell(str(row["name"])),
        cell(row["total_s"], ".0f"),
        cell(row["fresh_J"], ".2f"),
        cell(row["fit_J"], ".2f"),
        cell(row["coverage"], ".0f", 100.0),
        PageCell("model", view_url(item.MODEL, path), pick=path) if listed else PageCell("–"),
    )
