"""`ces identify --campaign`: many identifications in tables, and the recommended models."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from ces_cli.identify.request import OUT, IdentifyProgramRequest
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import print_warnings, with_distinct_names
from ces_cli.terminal.outputs import print_document, without_text
from ces_cli.terminal.progress import JobsProgress, report_failures, run_jobs
from ces_data.checks.check import check_each, require_sound
from ces_data.outputs import require_folder
from ces_data.signals_file import load_signals
from ces_identify.campaign.cells import CampaignRows, CellNames, compute_cell, is_proved
from ces_identify.campaign.plan import Campaign, CampaignJob, jobs, load_campaign
from ces_identify.jobs import DONE, ResultsFolder, Row, Task, open_results
from ces_identify.limits import ChoiceLimits
from ces_identify.validation.evaluate import IDENTIFICATION
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_report.table import Column, Table, as_csv

MAX_ROWS_SHOWN = 40  # rows in the terminal
RESULTS = "results.jsonl"
FRONT, BEST = "○", "●"
WORDS = {FRONT: "front", BEST: "recommended"}  # marks in files for other programs
SELECTION_NOTE = (
    "The selection cost, which the search used, decides the front and the recommendation; the validation costs beside "
    "it decide nothing."
)


def run_campaign(request: IdentifyProgramRequest, plan: Path) -> int:
    """Run the campaign that the file `plan` describes; returns the exit status."""
    folder = request.out
    if folder == OUT.default:
        raise CesError("--campaign needs a folder for its results; add --out DIR")
    require_folder(folder)
    campaign = load_campaign(plan)
    signals = load_signals(campaign.signals)
    read = {path: terminal.read_one(path, signals, terminal.FORCE) for path in campaign.paths}
    recordings = with_distinct_names(read)
    findings = check_each(list(recordings.values()))
    require_sound(findings, request.model.ignore_findings)
    print_warnings(findings)
    todo = jobs(campaign, recordings, repr(sorted(signals.by_name.items())), findings, request.model.ignore_findings)
    with open_results(folder / RESULTS, "a campaign") as results:
        missing = [job for job in todo if not results.has(job)]
        finished = True
        if missing:
            tasks = [Task(job, job.paths) for job in missing]
            threads = max(job.limits.threads for job in missing)
            progress = JobsProgress(len(todo), len(todo) - len(missing), "cells")
            describe = partial(describe_cell, collect_rows(campaign, todo, results))
            finished = run_jobs(compute_cell, tasks, recordings, threads, request.jobs, results, progress, describe)
        rows = collect_rows(campaign, todo, results)
        planned = Counter(job.cell.bags for job in todo)
        with without_text(request.json):
            if rows.done:
                write_csv(rows, folder / "results.csv")
                _print_results(rows, planned, folder)
    if request.json:
        marks = marks_of(rows)
        best = {name: folder / "models" / f"{row['key']}.json" for name, row in rows.recommended().items()}
        cells = [{**row, "mark": WORDS.get(marks.get(row["key"], ""))} for row in rows.rows]
        print_document("campaign", {"folder": folder, "planned": len(todo), "cells": cells, "recommended": best})
    return report_failures(rows.rows, len(todo), finished, "cells", rows.names.full_name)


def describe_cell(rows: CampaignRows, row: Row) -> str:
    """Return the result of a cell in a few words."""
    name = rows.names.full_name(row)
    if row["status"] != DONE:
        return f"{name}: {row['status']}: {row['reason']}"
    cost = "diverged" if row["selection_J"] is None else f"{row['selection_J']:.2f} %"
    return f"{name}: selection J {cost}, {row['parameters']} parameters, {row['seconds']:.1f} s"


def collect_rows(campaign: Campaign, todo: Sequence[CampaignJob], results: ResultsFolder) -> CampaignRows:
    """Return the results of the planned cells so far, by set of bags, size and cost."""
    by_key, bags = results.rows, list(campaign.bags)
    rows = [{**by_key[job.key], "bags": job.cell.bags, **job.cell.settings} for job in todo if job.key in by_key]
    rows.sort(key=lambda r: (bags.index(r["bags"]), r.get("parameters", 1e9), r.get("selection_J") or 1e9))
    return CampaignRows(tuple(rows), len(todo), CellNames.of(campaign))


def _print_results(results: CampaignRows, planned: Mapping[str, int], folder: Path) -> None:
    marks = marks_of(results)
    for table in result_tables(results, planned, MAX_ROWS_SHOWN):
        terminal.print_table(terminal.lay_out(table, lambda row: "bold" * (marks.get(row["key"]) == BEST)))
    each = ", for each delay" if "delay" in results.names.varied else ""
    terminal.print_line(
        f"{FRONT} on the front of selection cost against size, {BEST} recommended: the smallest model on the front "
        f"within {ChoiceLimits.COST_TOLERANCE:.0%} of the lowest cost{each}"
    )
    terminal.print_line(SELECTION_NOTE)
    for name, best in results.recommended().items():
        terminal.print_line(f"{name}: models/{best['key']}.json ({results.names.name(best)}; {best['size']})")
    print(f"results: {folder}/results.csv, models/")


def marks_of(results: CampaignRows) -> dict[str, str]:
    """Return by key the marks of the models on a front and of the recommended ones."""
    best = {row["key"]: BEST for row in results.recommended().values()}
    return dict.fromkeys(results.front_keys(), FRONT) | best


def result_tables(results: CampaignRows, planned: Mapping[str, int], max_rows: int) -> list[Table[Row]]:
    """Return a table for each set of bags; with more than `max_rows` rows in total, only rows on a front.

    `planned` is the number of cells of each set.
    """
    marks = marks_of(results)
    done = [row for row in results.rows if row["status"] == DONE]
    shown = [row for row in done if row["key"] in marks] if len(done) > max_rows else done
    missing = {True: "diverged", False: "–"}

    def number(value: float | None, otherwise: str) -> str:
        return otherwise if value is None else f"{value:.2f}"

    def cost(name: str) -> Callable[[Row], str]:
        return lambda row: number(_mean_cost(row, name), missing[any(one["set"] == name for one in row["costs"])])

    def stability(row: Row) -> str:
        if row["gain"] is not None:
            return f"gain {row['gain']:.3f}"
        return "passive" if is_proved(row) else "not proved"

    columns: list[Column[Row]] = [
        Column("", lambda row: marks.get(row["key"], "")),
        Column("model", results.names.name),
        Column("size", lambda row: str(row["parameters"]), figure=True),
        Column("selection", lambda row: number(row["selection_J"], "–"), figure=True),
        Column("fit", cost(IDENTIFICATION), figure=True),
        *(Column(name, cost(name), figure=True) for name in results.sets),
        Column("stability", stability, figure=True),
        Column("s", lambda row: f"{row['seconds']:.1f}", figure=True),
    ]
    tables = []
    for name in dict.fromkeys(row["bags"] for row in shown):
        count = f"{sum(row['bags'] == name for row in done)} of {planned[name]} models done"
        count += "; only those on the front" if len(shown) < len(done) else ""
        title = f"identified on {name} ({count}); costs J in %"
        tables.append(Table(columns, [row for row in shown if row["bags"] == name], title))
    return tables


def _mean_cost(row: Row, name: str) -> float | None:
    """Return the mean J [%] of a row over the recordings of a set; None if there are none or one diverged."""
    costs = [cost["J"] for cost in row.get("costs", ()) if cost["set"] == name]
    return sum(costs) / len(costs) if costs and None not in costs else None


def write_csv(results: CampaignRows, path: Path) -> None:
    """Write a line for each cell, with one column for the cost on each recording."""
    marks = marks_of(results)
    lines = []
    for row in results.rows:
        plain = {key: value for key, value in row.items() if key != "costs"}
        costs = {f"J {cost['set']}: {cost['recording']}": cost["J"] for cost in row.get("costs", ())}
        lines.append((plain, costs, WORDS.get(marks.get(row["key"], ""), "")))
    first = ("key", "status", "bags", "structure")
    settings = dict.fromkeys((*first, *(key for plain, _, _ in lines for key in plain)))
    recordings = dict.fromkeys(key for _, costs, _ in lines for key in costs)
    rows = ([*map(plain.get, settings), mark, *map(costs.get, recordings)] for plain, costs, mark in lines)
    write_atomically(path, as_csv([[*settings, "mark", *recordings], *rows]))
