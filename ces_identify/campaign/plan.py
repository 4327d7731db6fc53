"""What a campaign is to compute: the axes as a file gives them, their cross product as cells, and a key for each cell.

A key is the same whenever the result would be: it is a hash of the settings, of the recordings' bytes and of how they
are read, not of names, paths or the rest of the campaign.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from ces_identify.polynomial.regressors import CandidateRules
from ces_identify.recordings.recording import Recording
from ces_observer import __version__
from ces_observer.errors import CesError

BUILT_IN = "built-in"  # candidate rules
AUTO = "auto"  # a rate or bandwidth chosen from the data

Setting = bool | int | float | str
CellSettings = Mapping[str, Setting]


@dataclass(frozen=True)
class CellLimits:
    """Limits of each cell: most seconds, target cost [%], random starts from its seed on, and threads."""

    seconds: float = 60.0
    target: float = 0.0
    starts: int = 1
    threads: int = 1


@dataclass(frozen=True)
class Candidates:
    """Candidate rules, and the hash of the text they came from."""

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

    `bags` are alternatives to identify on, `validate` recordings that judge every cell, both by name. `structures`
    holds the axes of each structure alone, `common` those of all.
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

    def cells(self) -> tuple[Cell, ...]:
        """Return the cross product of all axes; seeds change fastest, so that early results tell of every structure."""
        cells = [
            Cell(bags, structure, settings)
            for bags in self.bags
            for structure, own in self.structures.items()
            for settings in _combinations({**own, **self.common})
        ]
        return tuple(sorted(cells, key=lambda cell: self.common["seed"].index(cell.seed)))


@dataclass(frozen=True)
class CampaignJob:
    """A cell with all it takes to compute it but the recordings themselves, which travel apart.

    `recordings` are the bags to identify on, `validation` the (set, bag) to judge on.
    """

    key: str
    cell: Cell
    limits: CellLimits
    split: float
    rules: CandidateRules | None
    recordings: tuple[Path, ...]
    validation: tuple[tuple[str, Path], ...]

    @property
    def identity(self) -> dict[str, Any]:
        """The columns that say which cell a row belongs to."""
        return {"key": self.key, "bags": self.cell.bags, "structure": self.cell.structure, **self.cell.settings}

    @property
    def output(self) -> str:
        """The file of the model, relative to the folder of the results."""
        return f"models/{self.key}.json"

    @property
    def paths(self) -> tuple[Path, ...]:
        """The bags to identify on, then those to validate on."""
        return (*self.recordings, *(path for _, path in self.validation))


def jobs(campaign: Campaign, recordings: Mapping[Path, Recording], described: str) -> tuple[CampaignJob, ...]:
    """Return the job of each cell. `described` is the text of the signals description the recordings were read with.

    A recording that a cell is identified on does not also validate it. The number of threads is no setting: it is not
    in the key. Raises CesError if two cells are the same.
    """
    made = [_job(campaign, cell, recordings, described) for cell in campaign.cells()]
    first: dict[str, CampaignJob] = {}
    for job in made:
        twin = first.setdefault(job.key, job)
        if twin is not job:
            raise CesError(
                f"{campaign.source}: '{twin.cell.bags}' and '{job.cell.bags}' hold the same recordings with the same "
                "settings; keep one"
            )
    return tuple(made)


def _job(campaign: Campaign, cell: Cell, recordings: Mapping[Path, Recording], described: str) -> CampaignJob:
    mine = campaign.bags[cell.bags]
    seen = {recordings[path].sha256 for path in mine}
    others = [(name, path) for name, paths in campaign.validate.items() for path in paths]
    validation = tuple((name, path) for name, path in others if recordings[path].sha256 not in seen)
    candidates = campaign.candidates.get(str(cell.settings.get("candidates")))
    facts = {
        "tool": __version__,
        "structure": cell.structure,
        "settings": {**cell.settings, "candidates": candidates.sha256 if candidates else None},
        "limits": [campaign.limits.seconds, campaign.limits.target, campaign.limits.starts],
        "split": campaign.split,
        "signals": described,
        "bags": [recordings[path].sha256 for path in mine],
        "validate": [[name, recordings[path].sha256] for name, path in validation],
    }
    rules = candidates.rules if candidates else None
    return CampaignJob(_digest(facts), cell, campaign.limits, campaign.split, rules, mine, validation)


def _digest(facts: object) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]


def _combinations(axes: Mapping[str, Sequence[Setting]]) -> list[CellSettings]:
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
