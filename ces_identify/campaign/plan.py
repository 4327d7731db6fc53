"""The plan of a campaign: its axes, their cross product as cells, and a key for each cell.

Cells with the same result have the same key: it is a hash of the settings, of the recordings' bytes and of the signals
description, not of names, paths or the rest of the campaign.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from ces_data.checks.content import require_distinct, shared_content
from ces_data.recording import Recording
from ces_identify.campaign.campaign_rows import CellNames
from ces_identify.options import STARTS, TARGET, THREADS, TIME
from ces_identify.polynomial.candidate_rules import CandidateRules
from ces_identify.polynomial.search_limits import THESIS
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_observer.fields import declare

BUILT_IN = "built-in"  # candidate rules,
BUILT_IN_THESIS = f"{BUILT_IN} of the thesis"  # and those of its procedure
AUTO = "auto"  # a rate or bandwidth chosen from the data

Setting = bool | int | float | str
CellSettings = Mapping[str, Setting]


@dataclass(frozen=True)
class CellLimits:
    """Limits of each cell: time [s], target cost [%], number of starts from its seed on, and threads."""

    time: float = declare(TIME)
    target: float = declare(TARGET)
    starts: int = declare(replace(STARTS, default=1))
    threads: int = declare(replace(THREADS, default=1))


@dataclass(frozen=True)
class Candidates:
    """Candidate rules, and the hash of their text."""

    rules: CandidateRules
    sha256: str


@dataclass(frozen=True)
class Cell:
    """One identification: the name of its set of bags, its structure, and a value on each axis."""

    bags: str
    structure: str
    settings: CellSettings

    @property
    def seed(self) -> int:
        """Seed of the first start."""
        return int(self.settings["seed"])


@dataclass(frozen=True)
class Campaign:
    """The axes of a campaign.

    `bags` are alternative sets of identification data, `validate` the validation data of every cell, both by name.
    `structures` holds the axes of each structure, `common` those of all.
    """

    source: Path
    bags: Mapping[str, tuple[Path, ...]]
    validate: Mapping[str, tuple[Path, ...]]
    structures: Mapping[str, Mapping[str, tuple[Setting, ...]]]
    common: Mapping[str, tuple[Setting, ...]]
    limits: CellLimits
    split: float
    signals: Path | None
    candidates: Mapping[str, Candidates]

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every bag once, in the order of the file."""
        sets = (*self.bags.values(), *self.validate.values())
        return tuple(dict.fromkeys(path for bags in sets for path in bags))

    @property
    def names(self) -> CellNames:
        """Names of the cells, by the settings that vary in the plan."""
        axes = [axis for own in (*self.structures.values(), self.common) for axis in own.items()]
        return CellNames(tuple(dict.fromkeys(name for name, values in axes if len(values) > 1)), len(self.bags) > 1)

    def cells(self) -> tuple[Cell, ...]:
        """Return the cross product of all axes, sorted by seed, so that early results cover every structure."""
        cells = [
            Cell(bags, structure, settings)
            for bags in self.bags
            for structure, own in self.structures.items()
            for settings in _combine({**own, **self.common})
        ]
        return tuple(sorted(cells, key=lambda cell: self.common["seed"].index(cell.seed)))


@dataclass(frozen=True)
class CampaignJob:
    """A cell with all its inputs except the recordings, which are sent separately.

    `recordings` are the bags to identify on, `validation` the pairs (set, bag) to validate on. `forced` are the
    findings in spite of which models are identified.
    """

    key: str
    cell: Cell
    limits: CellLimits
    split: float
    rules: CandidateRules | None
    recordings: tuple[Path, ...]
    validation: tuple[tuple[str, Path], ...]
    forced: tuple[str, ...] = ()

    @property
    def identity(self) -> dict[str, Any]:
        """The columns that identify the cell in a row."""
        return {"key": self.key, "bags": self.cell.bags, "structure": self.cell.structure, **self.cell.settings}

    @property
    def output(self) -> str:
        """The file of the model, relative to the results folder."""
        return f"models/{self.key}.json"

    @property
    def paths(self) -> tuple[Path, ...]:
        """The bags to identify on, then those to validate on."""
        return (*self.recordings, *(path for _, path in self.validation))


def jobs(
    campaign: Campaign, recordings: Mapping[Path, Recording], described: str, forced: tuple[str, ...] = ()
) -> tuple[CampaignJob, ...]:
    """Return the job of each cell. `described` is the text of the recordings' signals description.

    A recording that a cell is identified on, or a copy of it, does not also validate it. The number of threads is not
    part of the key. Raises CesError if two cells are the same, or if a cell's recordings have seconds in common.
    """
    by_key: dict[str, CampaignJob] = {}
    for cell in campaign.cells():
        job = replace(_job(campaign, cell, recordings, described), forced=forced)
        other = by_key.setdefault(job.key, job)
        if other is not job:
            raise CesError(
                f"{campaign.source}: '{other.cell.bags}' and '{cell.bags}' hold the same recordings with the same "
                "settings; keep one"
            )
    for job in {job.paths: job for job in by_key.values()}.values():
        used = [recordings[path] for path in job.recordings]
        require_distinct(used, [recordings[path] for _, path in job.validation])
    return tuple(by_key.values())


def _job(campaign: Campaign, cell: Cell, recordings: Mapping[Path, Recording], described: str) -> CampaignJob:
    mine = campaign.bags[cell.bags]
    hashes = [recordings[path].sha256 for path in mine]
    pairs = [(name, path) for name, paths in campaign.validate.items() for path in paths]
    used = [recordings[path] for path in mine]
    validation = tuple((name, path) for name, path in pairs if not _is_among(recordings[path], used))
    candidates = campaign.candidates.get(_candidates_name(cell.settings))
    facts = {
        "tool": __version__,
        "structure": cell.structure,
        "settings": {**cell.settings, "candidates": candidates.sha256 if candidates else None},
        "limits": [campaign.limits.time, campaign.limits.target, campaign.limits.starts],
        "split": campaign.split,
        "signals": described,
        "bags": hashes,
        "validate": [[name, recordings[path].sha256] for name, path in validation],
    }
    rules = candidates.rules if candidates else None
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]
    return CampaignJob(key, cell, campaign.limits, campaign.split, rules, mine, validation)


def _is_among(recording: Recording, used: Sequence[Recording]) -> bool:
    shared = (shared_content(one, recording) for one in used)
    return any(common is not None and common.whole for common in shared)


def _candidates_name(settings: CellSettings) -> str:
    name = str(settings.get("candidates"))
    return BUILT_IN_THESIS if name == BUILT_IN and settings["method"] == THESIS else name


def _combine(axes: Mapping[str, Sequence[Setting]]) -> list[CellSettings]:
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
