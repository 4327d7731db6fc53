"""What the page of a thing shows, before it is HTML: headline, facts, links, charts and tables.

Results such as campaigns and diagnoses have pages of their own, which their programs wrote: here they are summarised,
with links to these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypedDict

from flask import url_for

from ces_cli.desk.catalogue import Listing, ServedFolder
from ces_cli.desk.items import MODEL, REPORT, RESULT, Item, format_number, list_facts
from ces_identify.prepare.sampling import delay_text
from ces_observer.model import Model, load_model

MAX_BESIDE = 40
# Sent because of the results that stand beside them.
OF_FOLDER = ("results.csv", "fleet.csv", "plan.yaml", "augmented.json")


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


def item_url(item: Item) -> str:
    """Return the address of a thing: a report as it is, the page about anything else."""
    if item.kind == REPORT:
        return url_for("pages.send", path=item.path)
    return url_for("pages.show", kind=item.kind, path=item.path)


def content_of(folder: ServedFolder, listing: Listing, item: Item) -> PageContent:
    """Return the page of a model or result: its facts, and links to what belongs to it.

    Raises CesError, OSError or one of WRONG_CONTENT if the file has changed to something else.
    """
    content = PageContent(item.summary)
    path = folder.find_file(item.path)
    if item.kind == MODEL:
        content = _model_content(load_model(path), item)
    inside = f"{item.folder}/" if item.kind == RESULT and item.folder else "\0"
    beside = [
        other
        for other in listing.items
        if other is not item and not other.problem and (other.folder == item.folder or other.path.startswith(inside))
    ]
    beside.sort(key=lambda other: other.kind != REPORT)
    files = [name for name in OF_FOLDER if item.kind == RESULT and (path.parent / name).is_file()]
    content.links = [(other.label, item_url(other)) for other in beside[:MAX_BESIDE]]
    content.links += [(name, url_for("pages.send", path=f"{item.folder}/{name}".lstrip("/"))) for name in files]
    content.links.append((path.name, url_for("pages.send", path=item.path)))
    return content


def group_by_tests(items: Sequence[Item]) -> dict[str, list[Item]]:
    """Return things by the recordings that they were tested on, in their order: costs compare within a group only."""
    groups: dict[str, list[Item]] = {}
    for item in items:
        groups.setdefault(str(item.facts.get("tests", "")), []).append(item)
    return groups


def suggest_recordings(models: Sequence[Item], recordings: Sequence[Item], most: int) -> set[str]:
    """Return the recordings on which all models were validated, else one that no model was identified on."""
    validated = [set(item.facts["validation"]) for item in models]
    common = set.intersection(*validated) if validated else set()
    suggested = [item.path for item in recordings if item.name in common]
    if not suggested:
        used = {name for item in models for name in item.facts["recordings"]}
        suggested = [item.path for item in recordings if item.name not in used][:1]
    return set(suggested[:most])


def _model_content(model: Model, item: Item) -> PageContent:
    """Return what a model file says, checked as the observer checks it."""
    e = model.envelope
    named = (("position", e.position_m, "m"), ("speed", e.speed_m_s, "m/s"), ("current", e.current_A, "A"))
    facts = [(heading, text) for heading, text, _ in list_facts(MODEL, item)]
    facts += [
        ("rate", format_number(model.sampling.rate_Hz, "g", "Hz")),
        ("force known", delay_text(model.sampling.delay_s)),
        ("validated on", ", ".join(item.facts["validation"]) or "–"),
        ("written by", str(model.provenance.get("tool", "–"))),
        *((f"identified for {name}s", f"{low:.4g} to {high:.4g} {unit}") for name, (low, high), unit in named),
        ("estimates are held within", "{:.4g} to {:.4g} N".format(*model.force_envelope_N)),
        ("|force| in these ranges, proved", format_number((model.certificate or {}).get("force_bound_N"), ".4g", "N")),
    ]
    costs = model.provenance.get("cost_J_percent") or []
    rows = [(str(c["recording"]), str(c["role"]), format_number(c["J"], ".2f")) for c in costs]
    headings = ("recording", "role", "J %")
    tables = [PageTable(caption="Cost of a free run", headings=headings, rows=rows)] if rows else []
    proof = str(item.facts["certificate"])
    headline = f"{item.facts['structure']}, {model.size}. {proof[:1].upper()}{proof[1:]}."
    return PageContent(headline, facts=facts, tables=tables)
