"""The page of a campaign: for each set of recordings the front of cost against size, and the cells."""

from __future__ import annotations

from dataclasses import replace

from ces_identify.campaign.front import front, is_proved, recommend_model
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_serve.files import item
from ces_serve.files.bounded_reading import read_rows
from ces_serve.files.item import Item
from ces_serve.web import curves
from ces_serve.web.addresses import files_beside, view_url
from ces_serve.web.site import Site
from ces_serve.web.tables import PageCell, PageContent, PageTable, cell

FRONT, BEST = "○ on the front", "● recommended"


def campaign_content(where: Site, one: Item) -> PageContent:
    """Return the page of a campaign: the front and the cells of each set of recordings."""
    rows = read_rows(where.folder.find_file(one.path))
    done = [row for row in rows if row["status"] == DONE]
    content = PageContent(headline=one.summary)
    for n, bags in enumerate(dict.fromkeys(str(row["bags"]) for row in done)):
        own = [row for row in done if str(row["bags"]) == bags]
        content.tables.append(replace(_cells(one.folder, bags, own), chart=curves.campaign_chart(n, bags, own)))
    failed = [row for row in rows if row["status"] != DONE]
    if failed:
        cells = tuple(
            (PageCell(str(r["bags"])), PageCell(str(r["structure"])), PageCell(str(r["reason"]))) for r in failed
        )
        content.tables.append(PageTable("Failed", ("recordings", "structure", "reason"), cells))
    content.links = files_beside(where, one, ("campaign.html", "results.csv", "results.md", "pareto.svg"))
    return content


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


def _campaign_cells(folder: str, row: Row, marks: dict[str, str], sets: list[str]) -> tuple[PageCell, ...]:
    path = f"{folder}/models/{row['key']}.json".lstrip("/")
    return (
        PageCell(str(row["key"])[:8], view_url(item.MODEL, path), pick=path),
        PageCell(marks.get(row["key"], "")),
        PageCell(str(row["structure"])),
        PageCell(str(row["size"])),
        cell(row["selection_J"], ".2f"),
        *(cell(_mean_cost(row, name), ".2f") for name in sets),
        PageCell("proved" if is_proved(row) else "not proved"),
        cell(row["seconds"], ".1f"),
    )


def _mean_cost(row: Row, name: str) -> float | None:
    """Return the mean cost over the recordings of a set, None if one diverged."""
    costs = [cost["J"] for cost in row["costs"] if cost["set"] == name]
    return sum(costs) / len(costs) if costs and None not in costs else None
