"""The formats of logs that `ces import` reads: a line for each, with its suffixes and what a file is by them.

The module of that name in `ces_data.logs` has a function `open_log(path, mapping, progress)`, which returns a table or
channels with their own times.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

from ces_observer.errors import LIKE

LOG_FORMATS: Mapping[str, Mapping[str, str]] = {
    "csv": {".csv": "a CSV table", **dict.fromkeys((".txt", ".dat", ".tsv", ".lvm"), "a text table")},
    "json": dict.fromkeys((".json", ".jsonl", ".ndjson"), "a JSON file"),
    "mat": {".mat": "a MATLAB file"},
    "mdf": {".mf4": "an MDF4 log", ".mdf": "an MDF log", ".mf3": "an MDF log"},
    "can": {".blf": "a CAN log", ".asc": "a CAN log", ".log": "a log", ".trc": "a CAN log"},
    "tdms": {".tdms": "a TDMS file"},
    "parquet": {".parquet": "a Parquet table", ".pq": "a Parquet table"},
}
KINDS = {suffix: what for suffixes in LOG_FORMATS.values() for suffix, what in suffixes.items()}


def is_foreign(path: Path) -> bool:
    """Return whether a file is by its name a log that only `ces import` reads."""
    return path.suffix.lower() in KINDS and path.is_file()


def suggest_path(path: Path) -> str:
    """Return what a mistyped path may have meant, as `; did you mean 'bags/road'?`, '' if nothing is like it."""
    beside = [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else []
    near = get_close_matches(path.name, beside, n=1, cutoff=LIKE)
    return f"; did you mean '{path.with_name(near[0])}'?" if near else ""


def is_log(path: Path) -> bool:
    """Return whether a file is a log that is read like a bag, and not one that ces wrote, such as a model."""
    return is_foreign(path) and not is_ours(path)


def is_ours(path: Path) -> bool:
    """Return whether ces wrote a file: a model or a result, in JSON."""
    if path.suffix.lower() != ".json" or not path.is_file():
        return False
    with path.open("rb") as file:
        return re.match(rb'\s*\{\s*"schema"\s*:\s*"ces-', file.read(100)) is not None


def explain_import(path: Path) -> str:
    """Return what a foreign file is, and the command that makes a bag of it."""
    if is_ours(path):
        return "is a file that ces wrote, such as a model, and no recording; expected a bag"
    return (
        f"is {KINDS[path.suffix.lower()]}, not a rosbag2 bag; convert it: ces import {shlex.quote(str(path))} --out BAG"
    )
