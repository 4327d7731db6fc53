"""Campaigns in `ces compare`: the models on their fronts, and their page."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from ces_cli.terminal import terminal
from ces_cli.terminal.json_output import print_document
from ces_cli.terminal.tables import NONE
from ces_cli.terminal.terminal import make_table
from ces_identify.campaign.campaign_page import write_campaign_page
from ces_identify.campaign.campaign_rows import CampaignRows, pooled_cost, read_campaign
from ces_identify.jobs.row_log import Row
from ces_observer.errors import CesError


def front_models(folders: Sequence[Path], count: int) -> dict[str, str]:
    """Return by name the model files on the fronts of campaigns, at most `count` with the lowest selection cost.

    Says so if it leaves some out. Raises CesError if a campaign has no model.
    """
    found = [(row, _name(campaign, row, folder, folders), folder) for folder in folders
             for campaign in (_read(folder),) for row in _front(campaign)]  # fmt: skip
    found.sort(key=lambda one: one[0]["selection_J"])
    if len(found) > count:
        terminal.print_warning(
            f"{len(found)} models on the fronts; compared are the {count} with the lowest selection cost"
        )
    return {name: str(folder / "models" / f"{row['key']}.json") for row, name, folder in found[:count]}


def show_campaigns(folders: Sequence[Path], options: argparse.Namespace, facts: Mapping[str, str]) -> None:
    """Print the fronts of a campaign, and write its page to --report. Raises CesError for several campaigns."""
    if len(folders) > 1:
        raise CesError("several campaigns and no recording; add recordings to compare the models on their fronts")
    (folder,) = folders
    results = _read(folder)
    if options.report is not None:
        write_campaign_page(options.report, results, folder, folder.resolve().name, facts)
    if options.json:
        print_document("compare", {"campaign": str(folder), "cells": [_as_json(results, row) for row in results.done]})
        return
    for name in filter(results.of_bags, results.bags):
        terminal.print_table(_front_table(results, name))
    for row in results.failed:
        terminal.print_warning(f"{results.full_name(row)}: {row['status']}: {row['reason']}")


def _read(folder: Path) -> CampaignRows:
    results = read_campaign(folder)
    if not results.done:
        raise CesError(f"{folder}: no cell of this campaign has a model")
    return results


def _front(results: CampaignRows) -> list[Row]:
    keys = results.front_keys()
    return [row for row in results.done if row["key"] in keys]


def _name(results: CampaignRows, row: Row, folder: Path, folders: Sequence[Path]) -> str:
    """Return a name without commas, because sentences list several."""
    parts = [folder.resolve().name] if len(folders) > 1 else []
    parts += [row["bags"]] if len(results.bags) > 1 else []
    return "/".join([*parts, results.name(row).replace(", ", " ")])


def _front_table(results: CampaignRows, bags: str) -> Table:
    title = f"front of the models identified on {bags}; costs J in %"
    table = make_table(title, ("model", "file"), ("size", "selection", *results.sets))
    recommended = results.recommended().get(bags, {}).get("key")
    for row in (row for row in _front(results) if row["bags"] == bags):
        costs = [_number(pooled_cost(row, name)[0]) for name in results.sets]
        style = "bold" if row["key"] == recommended else ""
        file = f"models/{row['key'][:8]}….json"
        table.add_row(results.name(row), file, str(row["parameters"]), _number(row["selection_J"]), *costs, style=style)
    return table


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f}"


def _as_json(results: CampaignRows, row: Row) -> dict[str, Any]:
    return {"name": results.full_name(row), "on_front": row["key"] in results.front_keys(), **row}
