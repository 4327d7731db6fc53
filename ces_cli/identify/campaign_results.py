"""The results of a campaign: tables for the terminal, CSV and Markdown, and a picture of cost against size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ces_cli.terminal.results import style_axis, write_picture
from ces_cli.terminal.terminal import as_csv
from ces_identify.campaign.campaign_rows import COST_TOLERANCE, CellNames, front, is_proved, recommend_model
from ces_identify.campaign.plan import Campaign, CampaignJob
from ces_identify.jobs.results import DONE, Row
from ces_identify.structures import KITS
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer.json_text import write_atomically
from ces_report.table import Column, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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

    def named_marks(self) -> dict[str, str]:
        """Return by key the marks as words, for other programs."""
        return {key: {FRONT: "front", BEST: "recommended"}[mark] for key, mark in self.marks().items()}

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


def cell_table(summary: Summary, rows: Sequence[Row]) -> Table[Row]:
    """Return the table of cells with a model, for terminal and Markdown."""
    marks, names = summary.marks(), summary.names

    def cost(name: str) -> Callable[[Row], str]:
        missing = {True: "diverged", False: "–"}
        return lambda row: _number(mean_cost(row, name), missing[any(one["set"] == name for one in row["costs"])])

    columns: list[Column[Row]] = [
        Column("", lambda row: marks.get(row["key"], "")),
        Column("bags", lambda row: str(row["bags"]), page_only=True),
        Column("structure", lambda row: str(row["structure"]), page_only=True),
        Column("settings", names.settings, page_only=True),
        Column("model", names.name, terminal_only=True),
        Column("size", lambda row: str(row["parameters"]), figure=True),
        Column("J selection", lambda row: _number(row["selection_J"], "–"), figure=True, short="selection"),
        Column(f"J {IDENTIFICATION}", cost(IDENTIFICATION), figure=True, short="fit"),
        *(Column(f"J {name}", cost(name), figure=True, short=name) for name in summary.sets),
        Column("stability", _format_stability, figure=True),
        Column("s", lambda row: f"{row['seconds']:.1f}", figure=True),
        Column("key", lambda row: str(row["key"][:8]), figure=True, page_only=True),
    ]
    return Table(columns, rows)


def summary_tables(summary: Summary, max_rows: int) -> list[Table[Row]]:
    """Return a table for each set of bags; with more than `max_rows` rows in total, only rows on a front."""
    marks = summary.marks()
    done = [row for row in summary.rows if row["status"] == DONE]
    shown = [row for row in done if row["key"] in marks] if len(done) > max_rows else done
    tables = []
    for name in dict.fromkeys(row["bags"] for row in shown):
        count = f"{sum(row['bags'] == name for row in done)} of {summary.planned_by_bags[name]} models done"
        count += "; only those on the front" if len(shown) < len(done) else ""
        table = cell_table(summary, [row for row in shown if row["bags"] == name])
        tables.append(replace(table, title=f"identified on {name} ({count}); costs J in %"))
    return tables


def summary_facts(summary: Summary, folder: Path) -> dict[str, Any]:
    """Return the document of --json: every cell with its costs and its mark, and the recommended models."""
    marks = summary.named_marks()
    return {
        "folder": folder,
        "planned": summary.planned,
        "cells": [{**row, "mark": marks.get(row["key"])} for row in summary.rows],
        "recommended": {
            name: folder / "models" / f"{best['key']}.json"
            for name in summary.bags
            if (best := recommend_model(summary.of_bags(name))) is not None
        },
    }


def write_markdown(summary: Summary, path: Path) -> None:
    """Write the table of all models, how to read it, and the failures."""
    table = cell_table(summary, [row for row in summary.rows if row["status"] == DONE])
    columns = [column for column in table.columns if not column.terminal_only]
    head = [[c.heading for c in columns], ["---:" if c.figure else "---" for c in columns]]
    lines = ["| " + " | ".join(cells) + " |" for cells in (*head, *([c.text(r) for c in columns] for r in table.rows))]
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
    costs = {
        row["key"]: {f"J {cost['set']}: {cost['recording']}": cost["J"] for cost in row.get("costs", ())}
        for row in summary.rows
    }
    columns = dict.fromkeys(name for row in summary.rows for name in costs[row["key"]])
    plain = ["key", "status", "bags", "structure"]
    plain += list(
        dict.fromkeys(name for row in summary.rows for name in row if name not in (*plain, "costs", "pooled"))
    )
    marks = summary.named_marks()
    lines: list[list[object]] = [[*plain, "mark", *columns]]
    for row in summary.rows:
        own = costs[row["key"]]
        lines.append(
            [*(row.get(name) for name in plain), marks.get(row["key"], ""), *(own.get(name) for name in columns)]
        )
    write_atomically(path, as_csv(lines))


def _format_stability(row: Row) -> str:
    if row["gain"] is not None:
        return f"gain {row['gain']:.3f}"
    return "passive" if is_proved(row) else "not proved"


def _number(value: float | None, otherwise: str) -> str:
    return otherwise if value is None else f"{value:.2f}"


LOOKS = (("#3b6ea5", "o"), ("#d9722e", "s"), ("#4f8a4c", "^"), ("#8a4c7d", "D"), ("#9a8432", "v"), ("#2f8c8c", "P"))
LOOK = dict(zip(KITS, cycle(LOOKS), strict=False))
INK, PALE = "#333333", "#8a8a8a"
MAX_COLUMNS = 3
LOG_RATIO = 8.0  # ratio of largest to smallest above which an axis is logarithmic


def save_pareto_picture(summary: Summary, path: Path) -> None:
    """Draw the picture into a file."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    names = [name for name in summary.bags if any(row["status"] == DONE for row in summary.of_bags(name))]
    columns = min(MAX_COLUMNS, len(names))
    lines = -(-len(names) // columns)
    size = (max(7.2, 4.6 * columns), 3.7 * lines + 0.9)
    with mpl.rc_context({"svg.hashsalt": "ces", "svg.fonttype": "path"}):
        look = {"squeeze": False, "layout": "constrained", "sharey": True, "facecolor": "white"}
        figure, axes = plt.subplots(lines, columns, figsize=size, **look)  # type: ignore[call-overload]
        for axis, name in zip(axes.flat, names, strict=False):
            _panel(axis, name, summary)
        for axis in list(axes.flat)[len(names) :]:
            axis.set_visible(False)
        _scale(axes[0, 0], summary)
        _legend(figure, summary)
        write_picture(figure, path)


def _panel(axis: Axes, name: str, summary: Summary) -> None:
    """Draw the models identified on one set of bags, their front, and its validation costs."""
    rows = [row for row in summary.of_bags(name) if row["status"] == DONE and row["selection_J"] is not None]
    best = front(rows)
    on_front = {row["key"] for row in best}
    x, y = [row["parameters"] for row in best], [row["selection_J"] for row in best]
    axis.plot(x, y, drawstyle="steps-post", color=INK, lw=1.1, zorder=2)
    for row in rows:
        color, marker = LOOK[row["structure"]]
        size, alpha, order = (7.0, 1.0, 4) if row["key"] in on_front else (5.5, 0.4, 3)
        face = color if is_proved(row) else "white"
        look: dict[str, Any] = {"ms": size, "color": color, "markerfacecolor": face, "alpha": alpha, "zorder": order}
        axis.plot(row["parameters"], row["selection_J"], marker, **look)
    for row in best:
        costs = [cost for held_out in summary.sets if (cost := mean_cost(row, held_out)) is not None]
        if costs:
            mean = sum(costs) / len(costs)
            axis.plot([row["parameters"]] * 2, [row["selection_J"], mean], color=PALE, lw=0.8, ls=(0, (2, 2)), zorder=1)
            axis.plot(row["parameters"], mean, "_", ms=10, mew=1.8, color=PALE, zorder=2)
    title = f"identified on {name}"
    if (chosen := recommend_model(rows)) is not None:
        axis.plot(chosen["parameters"], chosen["selection_J"], "o", ms=14, mew=1.3, color=INK, mfc="none", zorder=5)
        title += f"\nrecommended: {chosen['size']}, J = {chosen['selection_J']:.2f} %"
    axis.set_title(title, loc="left", fontsize=9.5)
    only_polynomials = all(row["structure"] == POLYNOMIAL.option for row in summary.rows)
    axis.set_xlabel("terms" if only_polynomials else "parameters (for a polynomial: terms)", fontsize=9)
    axis.set_ylabel("cost J [%]", fontsize=9)
    _axis_scale(axis, "x", [row["parameters"] for row in rows])
    style_axis(axis)
    axis.tick_params(labelleft=True)


def _scale(axis: Axes, summary: Summary) -> None:
    """Set the cost scale shared by all panels: from 0, or logarithmic with a margin below."""
    rows = [row for row in summary.rows if row["status"] == DONE and row["selection_J"] is not None]
    shown = [cost for row in rows for name in summary.sets if (cost := mean_cost(row, name)) is not None]
    _axis_scale(axis, "y", [row["selection_J"] for row in rows] + shown)
    low, high = axis.get_ylim()
    axis.set_ylim(low / (high / low) ** 0.12 if axis.get_yscale() == "log" else 0.0, high)


def _axis_scale(axis: Axes, which: str, values: list[float]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    scaled = getattr(axis, f"{which}axis")
    if values and min(values) > 0.0 and max(values) > LOG_RATIO * min(values):
        axis.set(**{f"{which}scale": "log"})
        scaled.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        scaled.set_minor_formatter(NullFormatter())
    else:
        scaled.set_major_locator(MaxNLocator(integer=which == "x", nbins=8))
    scaled.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _legend(figure: Figure, summary: Summary) -> None:
    from matplotlib.lines import Line2D

    done = [row for row in summary.rows if row["status"] == DONE]
    handles = [
        Line2D([], [], color=color, marker=marker, ls="none", label=structure)
        for structure, (color, marker) in LOOK.items()
        if any(row["structure"] == structure for row in done)
    ]
    if not all(is_proved(row) for row in done):
        label = "stability not proved"
        handles.append(Line2D([], [], color=INK, marker="o", markerfacecolor="white", ls="none", label=label))
    handles.append(Line2D([], [], color=INK, lw=1.1, label="front, by selection cost"))
    handles.append(Line2D([], [], color=INK, marker="o", ms=11, markerfacecolor="none", ls="none", label="recommended"))
    if summary.sets:
        label = "validation cost (mean), not used for selection"
        handles.append(Line2D([], [], color=PALE, marker="_", ms=10, mew=1.8, ls="none", label=label))
    columns = 3 if len(handles) > 4 else 5
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, frameon=False, fontsize=8.5)
