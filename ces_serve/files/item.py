"""One thing that the folder holds: its kind, its place and its facts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

MODEL, REPORT, CAMPAIGN, DIAGNOSIS = "model", "report", "campaign", "diagnosis"
FLEET, ITERATION, STROKE, RECORDING, UNREADABLE = "fleet", "iteration", "stroke", "recording", "unreadable"
KINDS = {  # by kind: the heading of its page, one, and several of them
    MODEL: ("Models", "model", "models"),
    REPORT: ("Reports", "report", "reports"),
    CAMPAIGN: ("Campaigns", "campaign", "campaigns"),
    DIAGNOSIS: ("Diagnoses", "diagnosis", "diagnoses"),
    FLEET: ("Fleets", "fleet", "fleets"),
    ITERATION: ("Iterations", "iteration", "iterations"),
    STROKE: ("Learned strokes", "learned stroke", "learned strokes"),
    RECORDING: ("Recordings", "recording", "recordings"),
    UNREADABLE: ("Unreadable", "unreadable file", "unreadable files"),
}

HASHED = re.compile(r"[0-9a-f]{16,}\.json")
FOLDERS = {CAMPAIGN, DIAGNOSIS, FLEET, ITERATION, STROKE}  # known by one file in them, named for the folder


@dataclass(frozen=True)
class Item:
    """A thing at `path` (relative, with /), last changed at `modified_s` (Unix time).

    `facts` hold what its kind has to say; `problem` is why it cannot be read, empty if it can.
    """

    kind: str
    path: str
    modified_s: float
    facts: Mapping[str, Any] = field(default_factory=dict)
    problem: str = ""

    @property
    def name(self) -> str:
        """The last part of its path, or of its folder's path if it is a folder of results."""
        folder, _, last = self.path.rpartition("/")
        return folder.rpartition("/")[2] if folder and self.kind in FOLDERS else last

    @property
    def label(self) -> str:
        """Its name, shortened if that is a hash, as of a campaign's models."""
        return f"{self.name[:8]}…" if HASHED.fullmatch(self.name) else self.name

    @property
    def folder(self) -> str:
        """The path without its last part, empty at the top."""
        return self.path.rpartition("/")[0]

    @property
    def place(self) -> str:
        """Where its name is, empty at the top."""
        return self.folder.rpartition("/")[0] if self.folder and self.kind in FOLDERS else self.folder

    @property
    def cost_J(self) -> float | None:
        """Its cost [%], by which things are sorted, if it has one."""
        cost = self.facts.get("cost_J")
        return cost if isinstance(cost, float) else None

    @property
    def summary(self) -> str:
        """What it says in one line."""
        return self.problem or str(self.facts.get("summary", ""))

    def matches(self, words: tuple[str, ...]) -> bool:
        """Return whether all words, in lower case, are in its path, kind or facts."""
        text = f"{self.kind} {self.path} {self.summary} {self.facts.get('search', '')}".lower()
        return all(word in text for word in words)
