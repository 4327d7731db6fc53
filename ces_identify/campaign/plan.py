"""The plan of a campaign: a YAML file in, the cross product of its axes as cells out, a job with a key for each.

Paths in the file are relative to its folder. Cells with the same result have the same key: it is a hash of the
settings, of the recordings' bytes and of the signals description, not of names, paths or the rest of the campaign.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from ces_data.checks.content import require_distinct, shared_content
from ces_data.config_file import read_yaml_mapping
from ces_data.findings import Finding
from ces_data.recording import Recording
from ces_identify.options import (
    CANDIDATES,
    CERTIFICATE,
    DELAY,
    METHOD,
    RATE,
    SEED,
    SPLIT,
    STARTS,
    TARGET,
    TERMS,
    THREADS,
    TIME,
)
from ces_identify.polynomial.candidate_rules import CandidateRules
from ces_identify.polynomial.rules_file import built_in_rules, load_rules
from ces_identify.structures import KITS
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_observer.fields import Field
from ces_observer.options import Option
from ces_observer.records import Record, declare, record_of
from ces_observer.shapes import ByName

BUILT_IN = "built-in"  # candidate rules of the method
AUTO = "auto"  # a rate chosen from the data
MAX_CELLS = 100_000
NOMINAL_HZ = 1000.0  # rate for counting candidates

Setting = bool | int | float | str
Axes = Mapping[str, tuple[Setting, ...]]


def _by_name(*options: Option) -> dict[str, Option]:
    return {option.name: option for option in options}


RULES = replace(CANDIDATES, kind=str, default=BUILT_IN, form=f"{BUILT_IN} or a rules file")
STRUCTURES: Mapping[str, Mapping[str, Option]] = {  # the axes of each structure, and those of all
    **{kit.option: _by_name(*kit.sizes) for kit in KITS.values()},
    POLYNOMIAL.option: _by_name(replace(TERMS, default=15), METHOD, RULES),
}
COMMON = _by_name(replace(RATE, default=AUTO), DELAY, CERTIFICATE, SEED)


class CampaignError(CesError):
    """A campaign that cannot be run."""


@dataclass(frozen=True)
class CellLimits:
    """Limits of each cell: hard end [s], target cost [%], number of starts from its seed on, and threads."""

    time: float | None = declare(TIME)
    target: float = declare(TARGET)
    starts: int = declare(replace(STARTS, default=1))
    threads: int = declare(replace(THREADS, default=1))


@dataclass(frozen=True)
class Cell:
    """One identification: the name of its set of bags, its structure, and a value on each axis."""

    bags: str
    structure: str
    settings: Mapping[str, Setting]


@dataclass(frozen=True)
class Campaign:
    """The axes of a campaign.

    `bags` are alternative sets of identification data, `validate` the validation data of every cell, both by name.
    `structures` holds the axes of each structure, `common` those of all. `candidates` are the rules, with the hash of
    their text, by the method and the name in the cell's settings.
    """

    source: Path
    bags: Mapping[str, tuple[Path, ...]]
    validate: Mapping[str, tuple[Path, ...]]
    structures: Mapping[str, Axes]
    common: Axes
    limits: CellLimits
    split: float
    signals: Path | None
    candidates: Mapping[tuple[Any, Any], tuple[CandidateRules, str]]

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every bag once, in the order of the file."""
        sets = (*self.bags.values(), *self.validate.values())
        return tuple(dict.fromkeys(path for bags in sets for path in bags))

    def cells(self) -> tuple[Cell, ...]:
        """Return the cross product of all axes, sorted by seed, so that early results cover every structure."""
        cells = [
            Cell(bags, structure, dict(zip(axes, values, strict=True)))
            for bags in self.bags
            for structure, own in self.structures.items()
            for axes in ({**own, **self.common},)
            for values in product(*axes.values())
        ]
        return tuple(sorted(cells, key=lambda cell: self.common["seed"].index(cell.settings["seed"])))


def axis(option: Option) -> Field:
    """Return the field of an axis: a value of the option, or a list of different ones; a text may be a number."""
    also = (AUTO,) if option.kind is float and option.default == AUTO else ()
    kind = (str, int) if option.check_text else option.kind
    value = replace(option, default=(option.default,), also=also, kind=kind, key=option.name)
    return replace(value, many=True, min_count=1, different=True, or_one=True)


BAGS = Field(min_count=1, many=True, different=True, or_one=True)
SETS = Field(
    kind=ByName(BAGS, pattern=r"[\w.+-]+"), form="sets of recordings by name: {road: [road_1, road_2]}",
    rules={"minProperties": 1},
)  # fmt: skip
AXES = {name: record_of(**{key: axis(one) for key, one in axes.items()}) for name, axes in STRUCTURES.items()}
FILE = record_of(
    bags=SETS.about("sets of recordings to identify on; each gives models of its own"),
    validate=replace(SETS, meaning="recordings to validate every model on", default=None),
    structures=replace(
        record_of(**{name: replace(own, default=None, null=None) for name, own in AXES.items()}),
        form=f"a mapping with any of {', '.join(STRUCTURES)}", rules={"minProperties": 1},
    ),
    **{name: axis(option) for name, option in COMMON.items()},
    limits=Field(default=None, kind=Record(CellLimits)),
    split=SPLIT,
    signals=Field(default=None, null=None, meaning="signals file (default: the packaged one)"),
)  # fmt: skip


def load_campaign(path: Path) -> Campaign:
    """Read a campaign file; raises CampaignError, or CesError about a file with candidate rules."""
    content = read_yaml_mapping(path, "a campaign with bags and structures", error=CampaignError)
    given = FILE.check(content, str(path), CampaignError)
    for key in ("bags", "validate", "structures"):
        if content.get(key) in ({}, None) and key in content:
            raise CampaignError(f"{path}: {key} is {content[key]!r}; expected {FILE.kind.fields[key].expected}")
    structures = {name: given["structures"][name] or AXES[name].read({}) for name in content["structures"]}
    sets = {
        key: {name: tuple(_beside(path, bag) for bag in bags) for name, bags in (given[key] or {}).items()}
        for key in ("bags", "validate")
    }
    common = {name: given[name] for name in COMMON}
    count = len(sets["bags"]) * sum(math.prod(map(len, {**own, **common}.values())) for own in structures.values())
    if count > MAX_CELLS:
        raise CampaignError(f"{path}: {count} cells; at most {MAX_CELLS}: drop some values")
    return Campaign(
        source=path,
        **sets,
        structures=structures,
        common=common,
        limits=given["limits"] or CellLimits(),
        split=(1.0 if given["validate"] else 0.75) if given["split"] is None else given["split"],
        signals=_beside(path, given["signals"]) if given["signals"] else None,
        candidates=_load_candidates(path, structures.get(POLYNOMIAL.option, {})),
    )


def _beside(path: Path, name: str) -> Path:
    return path.parent / Path(name).expanduser()


def _load_candidates(path: Path, axes: Axes) -> dict[tuple[Any, Any], tuple[CandidateRules, str]]:
    """Return checked rules by method and name; raises CesError if they cannot be read or define too many candidates."""
    candidates = {}
    for method, name in product(axes.get("method", ()), axes.get("candidates", ())):
        file = None if name == BUILT_IN else _beside(path, str(name))
        rules = load_rules(file, str(method))
        try:
            rules.at_rate(NOMINAL_HZ).candidates()
        except CesError as error:
            raise CesError(f"{file}: {error}" if file else str(error)) from None
        text = file.read_bytes() if file else built_in_rules(str(method)).encode()
        candidates[method, name] = rules, hashlib.sha256(text).hexdigest()
    return candidates


@dataclass(frozen=True)
class CampaignJob:
    """A cell with all its inputs except the recordings, which are sent separately.

    `recordings` are the bags to identify on, `validation` the pairs (set, bag) to validate on. `findings` are those of
    the checks, in spite of which models are identified if they are ignored.
    """

    key: str
    cell: Cell
    limits: CellLimits
    split: float
    rules: CandidateRules | None
    recordings: tuple[Path, ...]
    validation: tuple[tuple[str, Path], ...]
    findings: tuple[Finding, ...] = ()
    ignore_findings: bool = False

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
    campaign: Campaign,
    recordings: Mapping[Path, Recording],
    described: str,
    findings: tuple[Finding, ...] = (),
    ignore_findings: bool = False,
) -> tuple[CampaignJob, ...]:
    """Return the job of each cell. `described` is the text of the recordings' signals description.

    A recording that a cell is identified on, or a copy of it, does not also validate it. The number of threads is not
    part of the key. Raises CesError if two cells are the same, or if a cell's recordings have seconds in common.
    """
    by_key: dict[str, CampaignJob] = {}
    for cell in campaign.cells():
        job = _make_job(campaign, cell, recordings, described)
        job = replace(job, findings=findings, ignore_findings=ignore_findings)
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


def _make_job(campaign: Campaign, cell: Cell, recordings: Mapping[Path, Recording], described: str) -> CampaignJob:
    mine, limits, settings = campaign.bags[cell.bags], campaign.limits, cell.settings
    validation = tuple(
        (name, path)
        for name, paths in campaign.validate.items()
        for path in paths
        if not any((same := shared_content(recordings[own], recordings[path])) and same.whole for own in mine)
    )
    rules, text_hash = campaign.candidates.get((settings.get("method"), settings.get("candidates")), (None, None))
    facts = {
        "tool": __version__,
        "structure": cell.structure,
        "settings": {**settings, "candidates": text_hash},
        "limits": [limits.time, limits.target, limits.starts],
        "split": campaign.split,
        "signals": described,
        "bags": [recordings[path].sha256 for path in mine],
        "validate": [[name, recordings[path].sha256] for name, path in validation],
    }
    key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:20]
    return CampaignJob(key, cell, limits, campaign.split, rules, mine, validation)
