"""The page of a campaign: all cells in a table to sort, and the front of cost against size and time."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from ces_identify.campaign.rows import CampaignRows, front, is_proved, pooled_cost, recommend_model
from ces_identify.jobs import Row
from ces_identify.structures import KITS
from ces_observer.json_text import write_atomically
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot, series_css
from ces_report.shell import command_block, page_template, replace_unencodable

PAGE = "campaign.html"
SELECTION = "selection"


def write_campaign_page(path: Path, results: CampaignRows, folder: Path, title: str, facts: Mapping[str, str]) -> None:
    """Write the page of the campaign in `folder` to `path`; `facts` may hold the `command`. Raises CesError."""
    links = os.path.relpath(folder.resolve(), path.resolve().parent)
    start = "" if links == "." else f"{links}/"
    recommended = {row["key"] for row in results.recommended().values()}
    page = page_template("campaign.html.j2", __package__ or "", ("campaign.css",)).render(
        title=title,
        headline=_headline(results),
        command=command_block(facts["command"]) if "command" in facts else "",
        compare=command_block(f"ces compare {folder}/models/*.json BAG --report compare.html"),
        recommended=[
            {"bags": bags, "name": results.names.name(row), "size": row["size"], "cost": _number(row["selection_J"]),
             **_links(row, folder, start)} for bags, row in results.recommended().items()
        ],
        panels=[_panel(results, n, name) for n, name in enumerate(results.bags) if results.of_bags(name)],
        sets=results.sets,
        delays="delay" in results.names.varied,
        several=len(results.bags) > 1,
        rows=[_row(results, row, row["key"] in recommended) | _links(row, folder, start) for row in results.done],
        failed=[{**row, "name": results.names.full_name(row)} for row in results.failed],
    )  # fmt: skip
    write_atomically(path, replace_unencodable(page))


def _links(row: Row, folder: Path, start: str) -> dict[str, str]:
    """Return the links to the files of a cell, empty where there is none; on the page they begin with `start`."""
    files = {"model": f"models/{row['key']}.json", "report": f"reports/{row['key']}.html"}
    return {what: quote(f"{start}{name}") if (folder / name).is_file() else "" for what, name in files.items()}


def _headline(results: CampaignRows) -> str:
    done, failed = len(results.done), len(results.failed)
    left = results.planned - done - failed
    parts = [f"{done} of {results.planned} cells have a model"]
    parts += [f"{failed} failed"] if failed else []
    parts += [f"{left} to come"] if left > 0 else []
    return "; ".join(parts) + "."


def _row(results: CampaignRows, row: Row, recommended: bool) -> dict[str, Any]:
    proof = "not proved"
    if is_proved(row):
        proof = "passive" if row["gain"] is None else f"gain {row['gain']:.3f}"
    return {
        "mark": "recommended" if recommended else "front" if row["key"] in results.front_keys() else "",
        "bags": row["bags"],
        "name": results.names.name(row),
        "size": row["size"],
        "parameters": row["parameters"],
        "selection": _number(row["selection_J"]),
        "costs": [_cost(row, name) for name in results.sets],
        "stability": proof,
        "seconds": _number(row["seconds"], 1),
    }


def _cost(row: Row, name: str) -> dict[str, str]:
    cost, interval = pooled_cost(row, name)
    return {
        "value": _number(cost) if name not in row["pooled"] or cost is not None else "diverged",
        "interval": "" if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}",
    }


def _number(value: float | None, decimals: int = 2) -> str:
    return "–" if value is None else f"{value:.{decimals}f}"


def _panel(results: CampaignRows, number: int, bags: str) -> dict[str, Any]:
    rows = [row for row in results.of_bags(bags) if row["selection_J"] is not None]
    swatch = Markup(
        '<svg class="plot-swatch" viewBox="0 0 22 10" aria-hidden="true"><path class="{} spot" d="M11,5h0"/></svg>'
    )
    return {
        "bags": bags,
        "structures": [
            (swatch.format(_structure_css(name)), name) for name in dict.fromkeys(row["structure"] for row in rows)
        ],
        "size": _pareto(results, rows, f"size{number}"),
        "delay": _draw_delays(results, f"delay{number}", bags),
    }


def _structure_css(structure: str) -> str:
    return series_css(list(KITS).index(structure))


def _pareto(results: CampaignRows, rows: list[Row], ident: str) -> Markup | None:
    """Return the chart of cost against size, each point with the name of its model; None without rows.

    Validation costs have their intervals. The front is drawn as steps: from each model on to the next larger one.
    """
    if not rows:
        return None
    dots: list[PlotLine | PlotDots] = []
    validation: list[PlotLine | PlotDots] = []
    for row in rows:
        x, model = float(row["parameters"]), results.names.name(row)
        css = f"{_structure_css(row['structure'])} spot{'' if is_proved(row) else ' unproved'}"
        dots.append(PlotDots(f"{model}: selection", np.array([x]), np.array([row["selection_J"]]), css))
        for name in results.sets:
            cost, interval = pooled_cost(row, name)
            if cost is not None:
                validation.append(PlotDots(f"{model}: {name}", np.array([x]), np.array([cost]), "validation dots"))
            if interval is not None:
                validation.append(PlotLine(f"{model}: {name}", np.array([x, x]), np.array(interval), "validation"))
    lines = []
    for group in results.of_delay(rows[0]["bags"]).values():
        points = [[float(row["parameters"]), row["selection_J"]] for row in front(group)]
        steps = np.repeat(np.array(points).reshape(-1, 2), 2, axis=0)
        lines.append(PlotLine("front, by selection cost", steps[1:, 0], steps[:-1, 1], "outline"))
    text = (
        f"Selection cost of {len(rows)} models; vertical lines are intervals of their costs on validation recordings."
    )
    area = PlotArea("Cost J [%]", [*dots, *validation, *lines], 300)  # values are read at the first of equal points
    title = f"Cost against size, identified on {rows[0]['bags']}"
    return draw_plot(Plot(ident, title, text, "Size [parameters]", [area], 560, free=True, legend=False))


def _draw_delays(results: CampaignRows, ident: str, bags: str) -> Markup | None:
    """Return the chart of the recommended models' costs, with their intervals, over the delay; None with one delay."""
    models = {1e3 * d: row for d, rows in results.of_delay(bags).items() if (row := recommend_model(rows)) is not None}
    if len(models) < 2:
        return None
    delays, nothing, marks = np.array(list(models)), (np.nan, np.nan), list[PlotLine | PlotDots]()
    for n, name in enumerate((SELECTION, *results.sets)):
        css, found = series_css(n), [pooled_cost(row, name) for row in models.values()]
        costs = [
            row["selection_J"] if name == SELECTION else J for row, (J, _) in zip(models.values(), found, strict=True)
        ]
        values = np.array(costs, np.float64)
        ends = np.array([nothing if interval is None else interval for _, interval in found])
        x = np.repeat(delays, 2)
        marks += [PlotLine(name, delays, values, css), PlotDots(name, delays, values, f"{css} spot")]
        marks.append(PlotLine(name, x, ends.ravel(), css, np.arange(len(x)) % 2 == 0))
    title = f"Cost over delay, identified on {bags}"
    text = f"Costs of the recommended models of {len(models)} delays."
    area = PlotArea("Cost J [%]", marks, 260)
    return draw_plot(Plot(ident, title, text, "Delay [ms]", [area], 560, free=True))
