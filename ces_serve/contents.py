"""What the page of a thing shows, before it is HTML: headline, facts, links, charts and tables.

Results such as campaigns and diagnoses have pages of their own, which their programs wrote: here they are summarised,
with links to these.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np
from flask import url_for

from ces_identify.prepare.sampling import delay_text
from ces_identify.progress_file import RUNNING, RunProgress
from ces_observer.model import Model, load_model
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot, series_css
from ces_serve.catalogue import Listing, ServedFolder
from ces_serve.items import MODEL, REPORT, RESULT, WRONG_CONTENT, Item, format_number, list_facts

WIDTH = 760.0
MAX_OVER_BEST = 5.0  # of a search: the first costs, which are far higher, would leave the rest a flat line
MAX_BESIDE = 40
# Sent because of the results that stand beside them.
OF_FOLDER = ("results.csv", "fleet.csv", "plan.yaml", "augmented.json", "command.csv", "learned.yaml")


class PageTable(TypedDict):
    """A table with a caption; rows of texts below the headings."""

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass
class PageContent:
    """The content of a page in its order: headline, warnings, facts (name and value), links, charts, tables.

    Its values are those of JSON, so that another process can send it.
    """

    headline: str = ""
    warnings: list[str] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)
    charts: list[str] = field(default_factory=list)
    tables: list[PageTable] = field(default_factory=list)


def item_url(one: Item) -> str:
    """Return the address of a thing: a report as it is, the page about anything else."""
    if one.kind == REPORT:
        return url_for("pages.send", path=one.path)
    return url_for("pages.show", kind=one.kind, path=one.path)


def content_of(folder: ServedFolder, listing: Listing, one: Item) -> PageContent:
    """Return the page of a model or result: its facts, and links to what belongs to it.

    Raises CesError, OSError or one of WRONG_CONTENT if the file has changed to something else.
    """
    content = PageContent(one.summary)
    path = folder.find_file(one.path)
    if one.kind == MODEL:
        content = _model_content(load_model(path), one)
    inside = f"{one.folder}/" if one.kind == RESULT and one.folder else "\0"
    beside = [
        other
        for other in listing.items
        if other is not one and not other.problem and (other.folder == one.folder or other.path.startswith(inside))
    ]
    beside.sort(key=lambda other: other.kind != REPORT)
    files = [name for name in OF_FOLDER if one.kind == RESULT and (path.parent / name).is_file()]
    content.links = [(other.label, item_url(other)) for other in beside[:MAX_BESIDE]]
    content.links += [(name, url_for("pages.send", path=f"{one.folder}/{name}".lstrip("/"))) for name in files]
    content.links.append((path.name, url_for("pages.send", path=one.path)))
    return content


def suggest_recordings(models: Sequence[Item], recordings: Sequence[Item], most: int) -> set[str]:
    """Return the recordings on which all models were validated, else one that no model was identified on."""
    validated = [set(one.facts["validation"]) for one in models]
    common = set.intersection(*validated) if validated else set()
    found = [one.path for one in recordings if one.name in common]
    if not found:
        used = {name for one in models for name in one.facts["recordings"]}
        found = [one.path for one in recordings if one.name not in used][:1]
    return set(found[:most])


def _model_content(model: Model, one: Item) -> PageContent:
    """Return what a model file says, checked as the observer checks it."""
    e = model.envelope
    named = (("position", e.position_m, "m"), ("speed", e.speed_m_s, "m/s"), ("current", e.current_A, "A"))
    facts = [(heading, text) for heading, text, _ in list_facts(MODEL, one)]
    facts += [
        ("rate", format_number(model.sampling.rate_Hz, "g", "Hz")),
        ("force known", " and ".join(delay_text(one.sampling.delay_s) for one in model.each)),
        ("validated on", ", ".join(one.facts["validation"]) or "–"),
        ("written by", str(model.provenance.get("tool", "–"))),
        *((f"{name} of the recordings", f"{low:.4g} to {high:.4g} {unit}") for name, (low, high), unit in named),
        ("bound of the force", "{:.4g} to {:.4g} N".format(*model.force_envelope_N)),
    ]
    costs = model.provenance.get("cost_J_percent") or []
    rows = [
        (str(c["recording"]), str(c["role"]), delay_text(c.get("delay_s", 0.0)), format_number(c["J"], ".2f"))
        for c in costs
    ]
    headings = ("recording", "role", "force known", "J %")
    tables = [PageTable(caption="Cost of a free run", headings=headings, rows=rows)] if rows else []
    return PageContent(
        f"{one.facts['structure']}, {model.size}. {one.facts['certificate']}.", facts=facts, tables=tables
    )


def running_content(path: str, progress: RunProgress) -> PageContent:
    """Return what a running program has found so far."""
    head = progress.head
    elapsed_s = max(0.0, time.time() - float(head.get("began_s") or time.time()))
    content = PageContent(f"{describe(progress)}.")
    content.facts = [("program", f"ces {head.get('program')}"), ("running for", format_number(elapsed_s, ".0f", "s"))]
    if head.get("program") == "jobs":
        content.facts = [*content.facts[1:], ("failed", str(progress.rows[-1].get("failed") if progress.rows else 0))]
        return content
    rows = _last_step(progress)
    newest = {row["seed"]: row for row in rows if "seed" in row}
    ended = sum(row["ended"] != RUNNING for row in newest.values())
    known = [
        ("structure", head.get("structure")),
        ("time limit", format_number(head.get("seconds"), "g", "s")),
        ("identified on", ", ".join(head.get("recordings") or ())),
        ("validated on", ", ".join(head.get("validation") or ())),
    ]
    content.facts += [(name, str(value)) for name, value in known if value not in ("", "–", None)]
    content.facts.append(("starts done", f"{ended} of {head['starts']}" if head.get("starts") else str(ended)))
    content.charts = _search_chart(rows, f"Search for {path}")
    return content


def describe(progress: RunProgress) -> str:
    """Return what a running program does, in one line, whatever its progress file holds."""
    head, rows = progress.head, progress.rows
    try:
        if head.get("program") == "jobs":
            done = rows[-1].get("done") if rows else head.get("done")
            return f"{done} of {head.get('total')} {head.get('things')} done"
        costs = [row["cost"] for row in _last_step(progress) if isinstance(row.get("cost"), int | float)]
        best = f"best selection cost J = {min(costs):.2f} %" if costs else "no model yet"
        step = next((row["step"] for row in reversed(rows) if "step" in row), "")
        return f"{step or head.get('program')}, {best}"
    except WRONG_CONTENT as error:
        return f"its progress cannot be read: {error}"


def _last_step(progress: RunProgress) -> list[dict[str, Any]]:
    """Return the rows of the present search."""
    rows = [dict(row) for row in progress.rows]
    begins = [k for k, row in enumerate(rows) if "step" in row]
    return rows[begins[-1] + 1 :] if begins else rows


def _search_chart(rows: Sequence[Mapping[str, Any]], title: str) -> list[str]:
    """Return the costs of the starts against the time, and the best so far; nothing before the first model."""
    found = [row for row in rows if isinstance(row.get("cost"), int | float)]
    if not found:
        return []
    limit = MAX_OVER_BEST * min(row["cost"] for row in found)
    shown = [row for row in found if row["cost"] <= limit]
    time_s, cost = (np.array([row[key] for row in shown], np.float64) for key in ("elapsed_s", "cost"))
    best = np.minimum.accumulate(cost)
    ended = np.array([row.get("ended") != RUNNING for row in shown])
    marks: list[PlotLine | PlotDots] = [
        PlotLine("best so far", np.repeat(time_s, 2)[1:], np.repeat(best, 2)[:-1], series_css(0)),
        PlotDots("improvement", time_s[~ended], cost[~ended], f"{series_css(0)} spot"),
        PlotDots("end of a start", time_s[ended], cost[ended], f"{series_css(1)} spot"),
    ]
    text = f"Selection cost of the best model so far: {best[-1]:.2f} % after {time_s[-1]:.1f} s."
    label = "Selection cost J [%]" + (f", up to {MAX_OVER_BEST:g} times the best" if len(shown) < len(found) else "")
    area, view = PlotArea(label, marks, height=240.0), (0.0, 1.03 * float(time_s[-1]))
    return [draw_plot(Plot("search", title, text, "Time [s]", [area], WIDTH, x_view=view))]
