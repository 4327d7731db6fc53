"""The formats of logs that `ces import` reads: a line for each, with its module in `ces_data.logs` and its suffixes.

The module has a function `open_log(path, mapping, progress)`, which returns a table or channels with their own times.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class LogFormat:
    """A format of logs: the name of its module, and what a file is by its suffix."""

    module: str
    suffixes: Mapping[str, str]


LOG_FORMATS = {
    "csv": LogFormat("csv", {".csv": "a CSV table", **dict.fromkeys((".txt", ".dat", ".tsv", ".lvm"), "a text table")}),
    "json": LogFormat("tree", {".json": "a JSON file"}),
    "mat": LogFormat("mat", {".mat": "a MATLAB file"}),
    "mdf": LogFormat("mdf", {".mf4": "an MDF4 log", ".mdf": "an MDF log", ".mf3": "an MDF log"}),
    "bag": LogFormat("bag", {".bag": "a ROS 1 bag"}),
    "can": LogFormat("can", {".blf": "a CAN log", ".asc": "a CAN log", ".log": "a log", ".trc": "a CAN log"}),
    "parquet": LogFormat("parquet", {".parquet": "a Parquet table", ".pq": "a Parquet table"}),
}
KINDS = {suffix: what for name, one in LOG_FORMATS.items() if name != "bag" for suffix, what in one.suffixes.items()}


def is_foreign(path: Path) -> bool:
    """Return whether a file is by its name a log that only `ces import` reads."""
    return path.suffix.lower() in KINDS and path.is_file()


def explain_import(path: Path) -> str:
    """Return what a foreign file is, and the command that makes a bag of it."""
    suffix = path.suffix.lower()
    if suffix == ".json":
        with path.open("rb") as file:
            if re.match(rb'\s*\{\s*"schema"\s*:\s*"ces-', file.read(100)):
                return "is a file that ces wrote, such as a model, and no recording; expected a bag"
    return f"is {KINDS[suffix]}, not a rosbag2 bag; convert it: ces import {shlex.quote(str(path))} --out BAG"
