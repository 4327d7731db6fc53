"""What the page of a thing shows, before it is HTML: headline, facts, links, charts and tables.

Results such as campaigns and diagnoses have pages of their own, which their programs wrote: here they are summarised,
with links to these.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from flask import url_for
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.progress_file import RUNNING, RunProgress, read_progress
from ces_observer.errors import CesError
from ces_observer.model import Model, load_model
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot, series_css
from ces_serve.catalogue import Catalogue, Listing, RunningSearch
from ces_serve.folder import ServedFolder
from ces_serve.items import MODEL, REPORT, RESULT, WRONG_CONTENT, Item, columns_of, format_number

WIDTH = 760.0
MAX_OVER_BEST = 5.0  # of a search: the first costs, which are far higher, would leave the rest a flat line
MAX_BESIDE = 40
OF_FOLDER = (  # sent because of the results that stand beside them
    *("results.csv", "fleet.csv", "plan.yaml", "augmented.json"),
    *("command.csv", "learned.yaml"),
)


@dataclass(frozen=True)
class PageTable:
    """A table with a caption; rows of texts below the headings."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass
class PageContent:
    """The content of a page in its order: headline, warnings, facts (name and value), links, charts, tables."""

    headline: str = ""
    warnings: list[str] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    links: list[tuple[str, str]] = field(default_factory=list)
    charts: Sequence[str] = field(default_factory=list)
    tables: list[PageTable] = field(default_factory=list)


def item_url(one: Item) -> str:
    """Return the address of a thing: a report as it is, the page about anything else."""
    if one.kind == REPORT:
        return url_for("pages.send", path=one.path)
    return url_for("pages.show", kind=one.kind, path=one.path)


def join_names(things: Iterable[Item]) -> str:
    """Return the paths of things in one line."""
    return ", ".join(one.path for one in things)


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


def from_json(text: str) -> PageContent:
    """Return the content that another process has written with `to_json`."""
    found = json.loads(text)
    found["charts"] = [Markup(chart) for chart in found["charts"]]  # drawn by us, in the other process
    found["tables"] = [PageTable(**table) for table in found["tables"]]
    return PageContent(**found)


def to_json(content: PageContent) -> str:
    """Return a content as JSON text."""
    return json.dumps(asdict(content))


def search_content(folder: ServedFolder, catalogue: Catalogue, path: str) -> tuple[bool, PageContent, str]:
    """Return whether a program with the output `path` is running, what it has found, and its title."""
    title = path if path != "." else folder.root.name
    search = _find_search(catalogue, path)
    if search is not None:
        try:
            return True, _running_content(path, search.progress), title
        except (CesError, OSError, *WRONG_CONTENT) as error:
            return True, PageContent(warnings=[f"cannot be read now: {error}"]), title
    found = [one for one in catalogue.listing(anew=True).items if path in (one.path, one.folder)]
    links = [(f"{one.name}, changed {one.changed}", item_url(one)) for one in found]
    return False, PageContent("" if found else "It has left no result in this folder.", links=links), title


def describe_search(search: RunningSearch) -> str:
    """Return what a running program does, in one line, whatever its progress file holds."""
    try:
        return f"{search.path}: {_describe(search.progress)}"
    except WRONG_CONTENT as error:
        return f"{search.path}: its progress cannot be read: {error}"


def suggest_recordings(models: Sequence[Item], recordings: Sequence[Item], most: int) -> set[str]:
    """Return the recordings on which all models were validated, else one that no model was identified on."""
    validated = [set(one.facts["validation"]) for one in models]
    common = set.intersection(*validated) if validated else set()
    found = [one.path for one in recordings if one.name in common]
    if not found:
        used = {name for one in models for name in one.facts["recordings"]}
        found = [one.path for one in recordings if one.name not in used][:1]
    return set(found[:most])


def describe_use(recording: Item, models: Sequence[Item]) -> str:
    """Return how many of the models were identified or validated on a recording of this name."""
    uses = (("identified", "recordings"), ("validated", "validation"))
    counts = [(what, sum(recording.name in one.facts[key] for one in models)) for what, key in uses]
    return ", ".join(f"{what} {count} of {len(models)}" for what, count in counts if count)


def _model_content(model: Model, one: Item) -> PageContent:
    """Return what a model file says, checked as the observer checks it."""
    e = model.envelope
    named = (("position", e.position_m, "m"), ("speed", e.speed_m_s, "m/s"), ("current", e.current_A, "A"))
    facts = [(column.heading, column.text(one)) for column in columns_of(MODEL)]
    facts += [
        ("rate", format_number(model.sampling.rate_Hz, "g", "Hz")),
        ("speed from", f"{model.sampling.differentiator}, {model.sampling.bandwidth_Hz:.4g} Hz"),
        ("validated on", ", ".join(one.facts["validation"]) or "–"),
        ("written by", str(model.provenance.get("tool", "–"))),
        *((f"{name} of the recordings", f"{low:.4g} to {high:.4g} {unit}") for name, (low, high), unit in named),
        ("bound of the force", "{:.4g} to {:.4g} N".format(*model.force_envelope_N)),
    ]
    costs = model.provenance.get("cost_J_percent") or []
    rows = tuple((str(c["recording"]), str(c["role"]), format_number(c["J"], ".2f")) for c in costs)
    tables = [PageTable("Cost of a free run", ("recording", "role", "J %"), rows)] if rows else []
    headline = f"{one.facts['structure']}, {model.size}. {one.facts['certificate']}."
    return PageContent(headline, facts=facts, tables=tables)


def _running_content(path: str, progress: RunProgress) -> PageContent:
    """Return what a running program has found so far."""
    head = progress.head
    elapsed_s = max(0.0, time.time() - float(head.get("began_s") or time.time()))
    content = PageContent(f"{_describe(progress)}.")
    content.facts = [("program", f"ces {head.get('program')}"), ("running for", format_number(elapsed_s, ".0f", "s"))]
    if head.get("program") == "jobs":
        content.facts = [*content.facts[1:], ("failed", str(progress.rows[-1].get("failed") if progress.rows else 0))]
        return content
    rows = _last_step(progress)
    newest = {row["seed"]: row for row in rows if "seed" in row}
    ended = sum(row["ended"] != RUNNING for row in newest.values())
    known = [("structure", head.get("structure")), ("time limit", format_number(head.get("seconds"), "g", "s"))]
    known += [("identified on", ", ".join(head.get("recordings") or ()))]
    known += [("validated on", ", ".join(head.get("validation") or ()))]
    content.facts += [(name, str(value)) for name, value in known if value not in ("", "–", None)]
    content.facts.append(("starts done", f"{ended} of {head['starts']}" if head.get("starts") else str(ended)))
    content.charts = _search_chart(rows, f"Search for {path}")
    best_first = sorted(newest.values(), key=lambda row: (row["cost"] is None, row["cost"] or 0.0))
    cells = tuple(
        (
            format_number(row["seed"], "d"),
            format_number(row["cost"], ".3f"),
            format_number(row["size"], "d"),
            format_number(row["elapsed_s"], ".1f"),
            str(row["ended"]),
        )
        for row in best_first
    )
    headings = ("start (seed)", "selection cost J %", "terms or parameters", "at s", "state")
    content.tables = [PageTable("Starts, best first", headings, cells)] if cells else []
    return content


def _describe(progress: RunProgress) -> str:
    head, rows = progress.head, progress.rows
    if head.get("program") == "jobs":
        done = rows[-1].get("done") if rows else head.get("done")
        return f"{done} of {head.get('total')} {head.get('things')} done"
    costs = [row["cost"] for row in _last_step(progress) if isinstance(row.get("cost"), int | float)]
    best = f"best selection cost J = {min(costs):.2f} %" if costs else "no model yet"
    step = next((row["step"] for row in reversed(rows) if "step" in row), "")
    return f"{step or head.get('program')}, {best}"


def _last_step(progress: RunProgress) -> list[dict[str, Any]]:
    """Return the rows of the present search."""
    rows = [dict(row) for row in progress.rows]
    begins = [k for k, row in enumerate(rows) if "step" in row]
    return rows[begins[-1] + 1 :] if begins else rows


def _find_search(catalogue: Catalogue, path: str) -> RunningSearch | None:
    """Return what runs with this output, as it is now: the list of the folder may be some seconds old."""
    found = next((one for one in catalogue.listing().searches if one.path == path), None)
    progress = read_progress(found.file) if found else None
    return replace(found, progress=progress) if found and progress and progress.alive else None


def _search_chart(rows: Sequence[Mapping[str, Any]], title: str) -> list[Markup]:
    """Return the costs of the starts against the time, and the best so far; nothing before the first model."""
    found = [row for row in rows if isinstance(row.get("cost"), int | float)]
    if not found:
        return []
    limit = MAX_OVER_BEST * min(row["cost"] for row in found)
    shown = [row for row in found if row["cost"] <= limit]
    time_s, cost = _array([row["elapsed_s"] for row in shown]), _array([row["cost"] for row in shown])
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


def _array(values: Iterable[float | None]) -> F:
    """Return numbers as an array, NaN for None."""
    return np.array([np.nan if value is None else value for value in values], np.float64)
