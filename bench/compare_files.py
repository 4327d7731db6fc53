"""Splits result files into values and wording, and lists the differences between two of them.

Values are numbers, and in JSON and CSV names without blanks, too, each list under its place in the file; they must be
equal. Wording is all other text. Versions, dates and hashes, which may differ, are replaced by a placeholder.
"""

from __future__ import annotations

import csv
import dataclasses
import filecmp
import html
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

Value = float | str
Pair = tuple[str, Value | None, Value | None]  # place, before, after; None where there is none

PROVENANCE = (
    (re.compile(r"[0-9a-f]{20,}|(?<=\w-)[0-9a-f]{8}\b"), "<hash>"),
    (re.compile(r"(ces_observer) \d+(\.\d+)+"), r"\1 <version>"),
    (re.compile(r"\d{4}-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?)?"), "<date>"),
)
NUMBER = re.compile(r"(?<![\w.])[-−+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
IN_PLOT = re.compile(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?")
SUFFIXES = frozenset((".json", ".jsonl", ".csv", ".mcap", ".html", ".txt", ".md", ".yaml", ".c", ".h"))


class Content:
    """The values of a result file by place, and its wording in order; nothing if there is no such file."""

    def __init__(self, path: Path) -> None:
        self.values: dict[str, list[Value]] = defaultdict(list)
        self.words: list[str] = []
        if path.suffix == ".mcap" and path.exists():
            self._read_bag(path.parent)
        elif path.exists():
            self._read(path.suffix, path.read_text(encoding="utf-8"))

    def _read(self, suffix: str, text: str) -> None:
        if suffix == ".json":
            self.add_tree("", json.loads(text))
        elif suffix == ".jsonl":
            self.add_tree("", [json.loads(line) for line in text.splitlines()])
        elif suffix == ".csv":
            self.add_tree("", list(csv.DictReader(text.splitlines())))
        elif suffix == ".html":
            self._read_page(re.sub(r"<style>.*?</style>", "", text, flags=re.DOTALL))
        else:
            for line in text.splitlines():
                self.add_text("text", line)

    def _read_page(self, text: str) -> None:
        for part in re.split(r"(<[^>]+>)", text):
            if part.startswith("<"):  # parts of plots
                self.values[part.split()[0]] += map(float, IN_PLOT.findall(without_provenance(part)))
            else:
                self.add_text("text", html.unescape(part))

    def _read_bag(self, folder: Path) -> None:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
            for connection, stamp_ns, raw in bag.messages():
                self.add_tree(connection.topic, list(divmod(stamp_ns, 1_000_000_000)))
                self.add_tree(connection.topic, bag.deserialize(raw, connection.msgtype))

    def add_tree(self, place: str, value: Any) -> None:
        """Add nested mappings, sequences, arrays and messages."""
        if isinstance(value, dict):
            for key in sorted(value):
                self.add_tree(f"{place}.{key}", value[key])
        elif isinstance(value, list | np.ndarray):
            for item in value:
                self.add_tree(place, item)
        elif dataclasses.is_dataclass(value):
            self.add_tree(place, vars(value))
        else:
            self._add_leaf(place, value)

    def _add_leaf(self, place: str, value: Any) -> None:
        try:
            number = float(value)
        except (TypeError, ValueError):
            self.add_text(place, str(value), whole=True)
        else:
            self.values[place].append("nan" if math.isnan(number) else number)

    def add_text(self, place: str, text: str, whole: bool = False) -> None:
        """Add the numbers in a text as values, the rest as wording; a name that is a `whole` text is a value."""
        text = " ".join(without_provenance(text).split())
        if whole and " " not in text:
            self.values[place].append(text)
        else:
            self.values[place] += [float(found.replace("−", "-")) for found in NUMBER.findall(text)]
            self.words += [NUMBER.sub("#", text)] if text else []


def without_provenance(text: str) -> str:
    """Return a text with placeholders for parts that may differ."""
    for pattern, placeholder in PROVENANCE:
        text = pattern.sub(placeholder, text)
    return text


@dataclasses.dataclass(frozen=True)
class FileComparison:
    """The number of compared values, those that differ, and differing wording, before and after."""

    compared: int
    values: tuple[Pair, ...]
    wording: tuple[tuple[str, str], ...]

    @property
    def largest(self) -> float:
        """The largest relative difference; infinite if something is missing or a name differs."""
        return max((_relative(before, after) for _, before, after in self.values), default=0.0)


def compare_files(before: Path, after: Path) -> FileComparison:
    """Return how two result files differ; a missing file lacks all values of the other."""
    same = before.exists() and after.exists() and filecmp.cmp(before, after, shallow=False)
    old = Content(before)
    new = old if same else Content(after)
    places = dict.fromkeys((*old.values, *new.values))
    pairs = [pair for place in places for pair in _differing(place, old.values[place], new.values[place])]
    count = sum(max(len(old.values[place]), len(new.values[place])) for place in places)
    wording = [(" / ".join(b), " / ".join(a)) for b, a in _find_changes(old.words, new.words)]
    return FileComparison(count, tuple(pairs), tuple(wording))


def _differing(place: str, before: list[Value], after: list[Value]) -> Iterator[Pair]:
    parts = [(before, after)] if len(before) == len(after) else _find_changes(before, after)
    return ((place, b, a) for old, new in parts for b, a in zip_longest(old, new) if b != a)


def _find_changes(before: Sequence[Any], after: Sequence[Any]) -> list[tuple[Sequence[Any], Sequence[Any]]]:
    """Return the passages that were replaced, removed or inserted."""
    found = SequenceMatcher(None, before, after).get_opcodes() if before != after else []
    return [(before[b:b_end], after[a:a_end]) for kind, b, b_end, a, a_end in found if kind != "equal"]


def _relative(before: Value | None, after: Value | None) -> float:
    if not isinstance(before, float) or not isinstance(after, float):
        return math.inf
    return abs(before - after) / max(abs(before), abs(after))
