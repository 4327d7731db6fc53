"""The page of a campaign: all cells in a table to sort, the front of cost against size and time, and what each axis
does."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from ces_identify.campaign.campaign_rows import CampaignRows, front, is_proved, pooled_cost
from ces_identify.jobs.results import Row
from ces_identify.structures import KITS
from ces_observer.json_text import write_atomically
from ces_report.charts import IntervalRow, draw_intervals
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot, series_css
from ces_report.shell import command_block, page_template, replace_unencodable

PAGE = "campaign.html"
REFRESH_S = 10  # between reloads of a page whose campaign is running
SIZE, TICK = "parameters", "tick_us"


def write_campaign_page(
    path: Path, results: CampaignRows, folder: Path, title: str, facts: Mapping[str, str], *, running: bool = False
) -> None:
    """Write the page of the campaign in `folder` to `path`; `facts` may hold the `command`. Raises CesError."""
    links = os.path.relpath(folder.resolve(), path.resolve().parent)
    write_atomically(
        path, campaign_page(results, folder, title, facts, links="" if links == "." else f"{links}/", running=running)
    )


def campaign_page(
    results: CampaignRows,
    folder: Path,
    title: str,
    facts: Mapping[str, str],
    *,
    links: str = "",
    running: bool = False,
) -> str:
    """Return the page of the campaign in `folder` as HTML.

    Links to its files begin with `links`. A page of a `running` campaign reloads itself.
    """
    found = _Links(folder, links)
    recommended = {row["key"] for row in results.recommended().values()}
    page = page_template("campaign.html.j2", __package__ or "", ("campaign.css",)).render(
        title=title,
        headline=_headline(results),
        refresh=REFRESH_S if running else None,
        command=command_block(facts["command"]) if "command" in facts else "",
        compare=command_block(f"ces compare {folder} BAG --report compare.html"),
        recommended=[_recommendation(results, name, row, found) for name, row in results.recommended().items()],
        panels=[_panel(results, n, name) for n, name in enumerate(results.bags) if results.of_bags(name)],
        sets=results.sets,
        several=len(results.bags) > 1,
        rows=[_row(results, row, row["key"] in recommended, found) for row in results.done],
        failed=[
            {"name": results.full_name(row), "status": row["status"], "reason": row["reason"]} for row in results.failed
        ],
    )
    return replace_unencodable(page)


@dataclass(frozen=True)
class _Links:
    """Links to files of a campaign in `folder`, from a page where its files begin with `start`."""

    folder: Path
    start: str

    def to(self, room: str, row: Row, suffix: str) -> str:
        """Return the link to a file of the cell, empty if there is none."""
        name = f"{room}/{row['key']}{suffix}"
        return quote(f"{self.start}{name}") if (self.folder / name).is_file() else ""


def _headline(results: CampaignRows) -> str:
    done, failed = len(results.done), len(results.failed)
    left = results.planned - done - failed
    parts = [f"{done} of {results.planned} cells have a model"]
    parts += [f"{failed} failed"] if failed else []
    parts += [f"{left} to come"] if left > 0 else []
    return "; ".join(parts) + "."


def _recommendation(results: CampaignRows, bags: str, row: Row, links: _Links) -> dict[str, Any]:
    return {"bags": bags, "name": results.name(row), "size": row["size"], "cost": _number(row["selection_J"]),
            "model": links.to("models", row, ".json"), "report": links.to("reports", row, ".html")}  # fmt: skip


def _row(results: CampaignRows, row: Row, recommended: bool, links: _Links) -> dict[str, Any]:
    mark = "recommended" if recommended else "front" if row["key"] in results.front_keys() else ""
    return {
        "mark": mark,
        "bags": row["bags"],
        "name": results.name(row),
        "size": row["size"],
        "parameters": row["parameters"],
        "selection": _number(row["selection_J"]),
        "costs": [_cost(row, name) for name in results.sets],
        "tick": _number(row.get(TICK), 1),
        "stability": _stability(row),
        "seconds": _number(row["seconds"], 1),
        "model": links.to("models", row, ".json"),
        "report": links.to("reports", row, ".html"),
    }


def _cost(row: Row, name: str) -> dict[str, str]:
    cost, interval = pooled_cost(row, name)
    shown = any(one["set"] == name for one in row.get("costs", ()))
    return {
        "value": _number(cost) if cost is not None else "diverged" if shown and "pooled" in row else "–",
        "interval": "" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}",
    }


def _stability(row: Row) -> str:
    if row["gain"] is not None:
        return f"gain {row['gain']:.3f}"
    return "passive" if is_proved(row) else "not proved"


def _number(value: float | None, decimals: int = 2) -> str:
    return "–" if value is None else f"{value:.{decimals}f}"


def _panel(results: CampaignRows, number: int, bags: str) -> dict[str, Any]:
    rows = [row for row in results.of_bags(bags) if row["selection_J"] is not None]
    return {
        "bags": bags,
        "structures": [(_swatch(name), name) for name in dict.fromkeys(row["structure"] for row in rows)],
        "size": _pareto(results, rows, number, SIZE),
        "tick": _pareto(results, [row for row in rows if row.get(TICK)], number, TICK),
        "effects": [
            draw_intervals(
                f"axis{number}-{axis}",
                f"Selection cost by {axis}",
                "Selection cost J [%]",
                [IntervalRow(value, min(J), max(J), median(J), _effect_text(J)) for value, J in values],
            )
            for axis, values in results.effects(bags).items()
        ],
    }


def _effect_text(costs: list[float]) -> str:
    if len(costs) == 1:
        return f"{costs[0]:.2f} (1 cell)"
    return f"{median(costs):.2f} ({min(costs):.2f} to {max(costs):.2f}; {len(costs)} cells)"


def _pareto(results: CampaignRows, rows: list[Row], number: int, what: str) -> Markup | None:
    """Return the chart of cost against `what`, each point with the name of its model; None without rows."""
    if not rows:
        return None
    label, name = ("Size [parameters]", "size") if what == SIZE else ("Time of a tick [µs]", "tick")
    marks: list[PlotLine | PlotDots] = [_selection_dot(results, row, float(row[what])) for row in rows]
    for row in rows:
        marks += _intervals(results, row, float(row[what]))
    marks.append(_front_line(rows, what))  # last: values are read at the first of equal points
    title = f"Cost against {'size' if what == SIZE else 'time of a tick'}, identified on {rows[0]['bags']}"
    text = (
        f"Selection cost of {len(rows)} models; vertical lines are intervals of their costs on validation recordings."
    )
    area = PlotArea("Cost J [%]", marks, 300)
    return draw_plot(Plot(f"{name}{number}", title, text, label, [area], 560, free=True, legend=False))


def _selection_dot(results: CampaignRows, row: Row, x: float) -> PlotDots:
    css = f"{series_css(list(KITS).index(row['structure']))} spot{'' if is_proved(row) else ' unproved'}"
    return PlotDots(f"{results.name(row)}: selection", np.array([x]), np.array([row["selection_J"]]), css)


def _intervals(results: CampaignRows, row: Row, x: float) -> list[PlotLine | PlotDots]:
    """Return the validation costs of a row with their intervals."""
    marks: list[PlotLine | PlotDots] = []
    for name in results.sets:
        cost, interval = pooled_cost(row, name)
        if cost is not None:
            marks.append(PlotDots(f"{results.name(row)}: {name}", np.array([x]), np.array([cost]), "validation dots"))
        if interval is not None:
            marks.append(PlotLine(f"{results.name(row)}: {name}", np.array([x, x]), np.array(interval), "validation"))
    return marks


def _front_line(rows: list[Row], what: str) -> PlotLine:
    """Return the front as steps: from each model on to the next larger one."""
    best = front(rows, what)
    x = np.repeat([float(row[what]) for row in best], 2)
    y = np.repeat([row["selection_J"] for row in best], 2)
    return PlotLine("front, by selection cost", x[1:], y[:-1], "outline")


def _swatch(structure: str) -> Markup:
    css = series_css(list(KITS).index(structure))
    return Markup(
        '<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true"><path class="{} spot" d="M11,5h0"/></svg>'
    ).format(css)
