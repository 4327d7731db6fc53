"""The results of a campaign as tables: for the terminal, as CSV with every recording, and as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.table import Table

from ces_cli.terminal.terminal import as_csv, make_table
from ces_identify.campaign.cell_names import CellNames
from ces_identify.campaign.front import COST_TOLERANCE, front, is_proved, recommend_model
from ces_identify.campaign.plan import Campaign, CampaignJob
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_observer.json_checks import write_atomically

IDENTIFICATION = "identification"
FRONT, BEST = "○", "●"
SELECTION_NOTE = (
    "The selection cost, which the search used, decides the front and the recommendation; the validation costs beside "
    "it decide nothing."
)


@dataclass(frozen=True)
class Summary:
    """The finished rows of a campaign, by set of bags and size; `names` names them."""

    rows: tuple[Row, ...]
    planned: int
    bags: tuple[str, ...]
    sets: tuple[str, ...]
    names: CellNames
    planned_by_bags: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def from_rows(cls, campaign: Campaign, todo: Sequence[CampaignJob], results: Mapping[str, Row]) -> Summary:
        """Take the rows of the plan's cells from all results; names come from the plan."""
        rows = [{**results[j.key], "bags": j.cell.bags, **j.cell.settings} for j in todo if j.key in results]
        bags = tuple(campaign.bags)
        rows.sort(key=lambda r: (bags.index(r["bags"]), r.get("parameters", 1e9), r.get("selection_J") or 1e9))
        sets = dict.fromkeys(cost["set"] for row in rows for cost in row.get("costs", ()))
        held_out = tuple(s for s in sets if s != IDENTIFICATION)
        return cls(tuple(rows), len(todo), bags, held_out, campaign.names, Counter(job.cell.bags for job in todo))

    def of_bags(self, name: str) -> list[Row]:
        """Return the rows of one set of bags."""
        return [row for row in self.rows if row["bags"] == name]

    def marks(self) -> dict[str, str]:
        """Return by key the marks of the models on a front and of the recommended ones."""
        marks = {}
        for rows in map(self.of_bags, self.bags):
            marks.update({row["key"]: FRONT for row in front(rows)})
            best = recommend_model(rows)
            marks.update({best["key"]: BEST} if best else {})
        return marks

    def lines(self) -> list[str]:
        """Return lines that explain the marks and name the recommended model for each set of bags."""
        lines = [
            f"{FRONT} on the front of selection cost against size, {BEST} recommended: the smallest model on the "
            f"front within {COST_TOLERANCE:.0%} of the lowest cost",
            SELECTION_NOTE,
        ]
        for name in self.bags:
            best = recommend_model(self.of_bags(name))
            if best is not None:
                lines.append(f"{name}: models/{best['key']}.json ({self.names.name(best)}; {best['size']})")
        return lines


def mean_cost(row: Row, name: str) -> float | None:
    """Return the mean J [%] of a row over the recordings of a set; None if there are none or one diverged."""
    costs = [cost["J"] for cost in row.get("costs", ()) if cost["set"] == name]
    return sum(costs) / len(costs) if costs and None not in costs else None


def summary_tables(summary: Summary, max_rows: int) -> list[Table]:
    """Return a table for each set of bags; with more than `max_rows` rows in total, only rows on a front."""
    marks = summary.marks()
    done = [row for row in summary.rows if row["status"] == DONE]
    shown = [row for row in done if row["key"] in marks] if len(done) > max_rows else done
    tables = []
    for name in dict.fromkeys(row["bags"] for row in shown):
        headings = [heading.removeprefix("J ").replace(IDENTIFICATION, "fit") for heading in _headings(summary)[4:-1]]
        count = f"{sum(row['bags'] == name for row in done)} of {summary.planned_by_bags[name]} models done"
        count += "; only those on the front" if len(shown) < len(done) else ""
        tables.append(make_table(f"identified on {name} ({count}); costs J in %", ("", "model"), headings))
        for row in (row for row in shown if row["bags"] == name):
            mark, _, _, _, *numbers, _ = _cells(summary, row, marks)
            tables[-1].add_row(mark, summary.names.name(row), *numbers, style="bold" if mark == BEST else "")
    return tables


def summary_facts(summary: Summary, folder: Path) -> dict[str, Any]:
    """Return the document of --json: every cell with its costs and its mark, and the recommended models."""
    marks = {FRONT: "front", BEST: "recommended"}
    mark_of = summary.marks()
    return {
        "folder": folder,
        "planned": summary.planned,
        "cells": [{**row, "mark": marks.get(mark_of.get(row["key"], ""))} for row in summary.rows],
        "recommended": {
            name: folder / "models" / f"{best['key']}.json"
            for name in summary.bags
            if (best := recommend_model(summary.of_bags(name))) is not None
        },
    }


def write_markdown(summary: Summary, path: Path) -> None:
    """Write the table of all models, how to read it, and the failures."""
    marks, headings = summary.marks(), _headings(summary)
    right = ["---:" if i > 3 else "---" for i in range(len(headings))]
    rows = [_cells(summary, row, marks) for row in summary.rows if row["status"] == DONE]
    lines = ["| " + " | ".join(cells) + " |" for cells in (headings, right, *rows)]
    lines += [
        "",
        "Costs J in percent are means over the recordings of a set. Size: parameters; for a polynomial, terms.",
    ]
    lines += ["Models: `models/KEY….json`.", ""]
    lines += ["* " + line for line in summary.lines()]
    lines += [
        f"* {row['status']}: {summary.names.full_name(row)}: {row['reason']}" for row in summary.rows if "reason" in row
    ]
    write_atomically(path, "\n".join(["# Campaign", "", "![cost against parameters](pareto.svg)", "", *lines, ""]))


def write_csv(summary: Summary, path: Path) -> None:
    """Write a line for each cell, with one column for the cost on each recording."""
    columns = dict.fromkeys(_column(cost) for row in summary.rows for cost in row.get("costs", ()))
    plain = ["key", "status", "bags", "structure"]
    plain += list(
        dict.fromkeys(name for row in summary.rows for name in row if name not in (*plain, "costs", "pooled"))
    )
    marks = {FRONT: "front", BEST: "recommended"}
    mark_of = summary.marks()
    lines: list[list[object]] = [[*plain, "mark", *columns]]
    for row in summary.rows:
        costs = {_column(cost): cost["J"] for cost in row.get("costs", ())}
        mark = marks.get(mark_of.get(row["key"], ""), "")
        lines.append([*(row.get(name) for name in plain), mark, *(costs.get(name) for name in columns)])
    write_atomically(path, as_csv(lines))


def _column(cost: Row) -> str:
    return f"J {cost['set']}: {cost['recording']}"


def _headings(summary: Summary) -> list[str]:
    costs = [f"J {name}" for name in ("selection", IDENTIFICATION, *summary.sets)]
    return ["", "bags", "structure", "settings", "size", *costs, "stability", "s", "key"]


def _cells(summary: Summary, row: Row, marks: Mapping[str, str]) -> list[str]:
    evaluated = {cost["set"] for cost in row["costs"]}
    costs = [
        _number(mean_cost(row, name), "diverged" if name in evaluated else "–")
        for name in (IDENTIFICATION, *summary.sets)
    ]
    return [
        marks.get(row["key"], ""),
        row["bags"],
        row["structure"],
        summary.names.settings(row),
        str(row["parameters"]),
        _number(row["selection_J"], "–"),
        *costs,
        _format_stability(row),
        f"{row['seconds']:.1f}",
        row["key"][:8],
    ]


def _format_stability(row: Row) -> str:
    if row["gain"] is not None:
        return f"gain {row['gain']:.3f}"
    return "passive" if is_proved(row) else "not proved"


def _number(value: float | None, otherwise: str) -> str:
    return otherwise if value is None else f"{value:.2f}"
