"""The pages of models, campaigns, diagnoses, fleets, iterations and learned strokes: a file goes in, content comes out.

Every function raises CesError, OSError or one of WRONG_CONTENT if the file has changed to something else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from flask import url_for

from ces_identify.campaign.front import front, is_proved, recommend_model
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_observer.model import Model, load_model
from ces_serve.files import item
from ces_serve.files.bounded_reading import read_json, read_rows
from ces_serve.files.facts import structure_name
from ces_serve.files.item import Item
from ces_serve.web import curves
from ces_serve.web.site import Site
from ces_serve.web.tables import Cell, Content, PageTable, cell, join, number, upper_first

MIN_CAUSES, SHOWN_FROM = 4, 0.01  # causes in any case, and the probability of further ones
FRONT, BEST = "○ on the front", "● recommended"


def model_content(where: Site, one: Item) -> Content:
    """Return the page of a model, checked as the observer checks it."""
    model = load_model(where.folder.find_file(one.path))
    content = Content(
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
    rows = [(Cell(str(c["recording"])), Cell(str(c["role"])), cell(c["J"], ".2f")) for c in costs]
    if rows:
        content.tables = [PageTable("Cost of a free run", ("recording", "role", "J %"), tuple(rows))]
    content.links = [("model file (JSON)", url_for("files.send", path=one.path))]
    return content


def campaign_content(where: Site, one: Item) -> Content:
    """Return the page of a campaign: the front and the cells of each set of recordings."""
    rows = read_rows(where.folder.find_file(one.path))
    done = [row for row in rows if row["status"] == DONE]
    content = Content(headline=one.summary)
    for n, bags in enumerate(dict.fromkeys(str(row["bags"]) for row in done)):
        own = [row for row in done if str(row["bags"]) == bags]
        content.tables.append(replace(_cells(one.folder, bags, own), chart=curves.campaign_chart(n, bags, own)))
    failed = [row for row in rows if row["status"] != DONE]
    if failed:
        cells = tuple((Cell(str(r["bags"])), Cell(str(r["structure"])), Cell(str(r["reason"]))) for r in failed)
        content.tables.append(PageTable("Failed", ("recordings", "structure", "reason"), cells))
    content.links = _files(where, one, ("campaign.html", "results.csv", "results.md", "pareto.svg"))
    return content


def diagnosis_content(where: Site, one: Item) -> Content:
    """Return the page of a diagnosis; its report says more."""
    found = read_json(where.folder.find_file(one.path))
    gap, causes = found["gap"], found["causes"]
    content = Content(headline=str(found["sentence"]), warnings=[str(note) for note in found.get("notes") or ()])
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
        *_files(where, one, ("report.html", "augmented.json")),
        ("gap.json", url_for("files.send", path=one.path)),
    ]
    return content


def fleet_content(where: Site, one: Item) -> Content:
    """Return the page of a fleet, largest gap first."""
    rows = read_rows(where.folder.find_file(one.path))
    rows.sort(key=lambda row: (row["status"] != DONE, -(row.get("gap_N") or 0.0)))
    content = Content(headline=one.summary, links=_files(where, one, ("fleet.html", "fleet.csv")))
    headings = ("unit", "verdict", "probability", "gap N", "after N", "says")
    content.tables = [PageTable("Units, largest gap first", headings, tuple(_unit(where, one, row) for row in rows))]
    return content


def iteration_content(where: Site, one: Item) -> Content:
    """Return the page of an iteration: how the costs fell with the recorded seconds."""
    rows = read_rows(where.folder.find_file(one.path))
    content = Content(headline=one.summary, charts=curves.iteration_chart(rows))
    headings = ("experiment", "s", "J % before it was used", "J % fit", "covered %", "model")
    content.tables = [PageTable("Iterations", headings, tuple(_iteration(where, one, row) for row in rows))]
    content.links = _files(where, one, ("report.html", "model.json", "plan.yaml"))
    return content


def stroke_content(where: Site, one: Item) -> Content:
    """Return the page of a learned stroke: the error of each run."""
    found = read_json(where.folder.find_file(one.path))
    content = Content(headline=one.summary, warnings=[str(text) for text in found.get("warnings") or ()])
    content.facts = [
        ("repeatability", number(1e3 * found["repeatability_m"], ".4f", "mm RMS")),
        ("bandwidth of learning", number(found["filter"]["bandwidth_Hz"], ".1f", "Hz")),
        ("stopped", str(found["stopped"])),
    ]
    content.charts = curves.stroke_chart(found["runs"], found["repeatability_m"])
    runs = tuple(
        (Cell(str(n)), Cell(str(run["kind"])), cell(run["error_m"], ".4f", 1e3), cell(run["gain"], "g"))
        for n, run in enumerate(found["runs"], start=1)
    )
    content.tables = [PageTable("Runs", ("run", "kind", "error mm RMS", "gain"), runs)]
    content.links = _files(where, one, ("report.html", "command.csv", "learned.yaml"))
    return content


def view_url(kind: str, path: str) -> str:
    """Return the address of the page about a thing."""
    return url_for("details.show", kind=kind, path=path)


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
            Cell(str(c["effect"]).replace("_", " ")),
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


def _cells(folder: str, bags: str, rows: list[Row]) -> PageTable:
    marks = {row["key"]: FRONT for row in front(rows)}
    best = recommend_model(rows)
    marks.update({best["key"]: BEST} if best else {})
    sets = list(dict.fromkeys(str(cost["set"]) for row in rows for cost in row["costs"]))
    headings = ("model", "", "structure", "size", "selection J %", *(f"{name} J %" for name in sets), "stability", "s")
    ordered = sorted(rows, key=lambda row: (row["parameters"], row["selection_J"] or 1e9))
    return PageTable(
        f"Identified on {bags}",
        headings,
        tuple(_campaign_cells(folder, row, marks, sets) for row in ordered),
        "The selection cost, which the search used, decides front and recommendation; other costs decide nothing.",
    )


def _campaign_cells(folder: str, row: Row, marks: dict[str, str], sets: list[str]) -> tuple[Cell, ...]:
    path = f"{folder}/models/{row['key']}.json".lstrip("/")
    return (
        Cell(str(row["key"])[:8], view_url(item.MODEL, path), pick=path),
        Cell(marks.get(row["key"], "")),
        Cell(str(row["structure"])),
        Cell(str(row["size"])),
        cell(row["selection_J"], ".2f"),
        *(cell(_mean_cost(row, name), ".2f") for name in sets),
        Cell("proved" if is_proved(row) else "not proved"),
        cell(row["seconds"], ".1f"),
    )


def _mean_cost(row: Row, name: str) -> float | None:
    """Return the mean cost over the recordings of a set, None if one diverged."""
    costs = [cost["J"] for cost in row["costs"] if cost["set"] == name]
    return sum(costs) / len(costs) if costs and None not in costs else None


def _unit(where: Site, one: Item, row: Row) -> tuple[Cell, ...]:
    if row["status"] != DONE:
        return (
            Cell(str(row["name"])),
            Cell(str(row["status"])),
            *[Cell("–", numeric=True)] * 3,
            Cell(str(row["reason"])),
        )
    path = f"{one.folder}/{row['folder']}/gap.json".lstrip("/")
    listed = where.catalogue.listing().find(item.DIAGNOSIS, path)
    verdict = ": ".join(filter(None, (str(row["verdict"]), " + ".join(map(str, row["effects"]))))).replace("_", " ")
    return (
        Cell(str(row["name"]), view_url(item.DIAGNOSIS, path) if listed else ""),
        Cell(verdict),
        cell(row["probability"], ".2f"),
        cell(row["gap_N"], ".1f"),
        cell(row["gap_after_N"], ".1f"),
        Cell(str(row["sentence"])),
    )


def _iteration(where: Site, one: Item, row: Row) -> tuple[Cell, ...]:
    path = f"{one.folder}/{row['model']}".lstrip("/")
    listed = where.catalogue.listing().find(item.MODEL, path)
    return (
        Cell(str(row["name"])),
        cell(row["total_s"], ".0f"),
        cell(row["fresh_J"], ".2f"),
        cell(row["fit_J"], ".2f"),
        cell(row["coverage"], ".0f", 100.0),
        Cell("model", view_url(item.MODEL, path), pick=path) if listed else Cell("–"),
    )


def _files(where: Site, one: Item, names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return links to those of the named files that are beside a thing."""
    folder = where.folder.root / one.folder
    there = [name for name in names if (folder / name).is_file()]
    return [(name, url_for("files.send", path="/".join(filter(None, (one.folder, name))))) for name in there]
