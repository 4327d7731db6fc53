"""Files that hold measurements but are no bags: what they are by their name, and how to make a bag of one."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

KINDS = {
    ".csv": "a CSV table",
    ".tsv": "a text table",
    ".txt": "a text table",
    ".dat": "a text table",
    ".lvm": "a text table",
    ".json": "a JSON file",
    ".mat": "a MATLAB file",
    ".mf4": "an MDF4 log",
    ".mdf": "an MDF log",
    ".mf3": "an MDF log",
    ".parquet": "a Parquet table",
    ".pq": "a Parquet table",
    ".blf": "a CAN log",
    ".asc": "a CAN log",
    ".trc": "a CAN log",
    ".log": "a log",
}


def is_foreign(path: Path) -> bool:
    """Return whether a file is by its name a log that `ces import` may convert."""
    return path.suffix.lower() in KINDS and path.is_file()


def explain_import(path: Path) -> str:
    """Return what a foreign file is, and the command that makes a bag of it."""
    if path.suffix.lower() == ".json" and _is_own(path):
        return "is a file that ces wrote, such as a model, and no recording; expected a bag"
    return (
        f"is {KINDS[path.suffix.lower()]}, not a rosbag2 bag; convert it: ces import {shlex.quote(str(path))} --out BAG"
    )


def _is_own(path: Path) -> bool:
    """Return whether a JSON file begins as those that `ces` writes do."""
    with path.open("rb") as file:
        return re.match(rb'\s*\{\s*"schema"\s*:\s*"ces-', file.read(100)) is not None
