"""The plan of a campaign: a YAML file in, the cross product of its axes as cells out, a job with a key for each.

Paths in the file are relative to its folder. Cells with the same result have the same key: it is a hash of the
settings, of the recordings' bytes and of the signals description, not of names, paths or the rest of the campaign.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Collection, Mapping
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
from ces_identify.polynomial.candidates import CandidateRules, built_in_rules, load_rules
from ces_identify.structures import KITS
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_observer.fields import Field, Schema, declare, read_record, require_known_keys
from ces_observer.options import Option

BUILT_IN = "built-in"  # candidate rules of the method
AUTO = "auto"  # a rate chosen from the data
MAX_CELLS = 100_000
NOMINAL_HZ = 1000.0  # rate for counting candidates
_NAME = re.compile(r"[\w.+-]+\Z")

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
KEYS = ("bags", "validate", "structures", *COMMON, "limits", "split", "signals")


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


def load_campaign(path: Path) -> Campaign:
    """Read a campaign file; raises CampaignError, or CesError about a file with candidate rules."""
    content = read_yaml_mapping(path, "a campaign with bags and structures", KEYS, CampaignError)
    named = _require_mapping(content.get("structures"), f"{path}: structures", STRUCTURES)
    structures = {}
    for name, given in named.items():
        where = f"{path}: structures: {name}"
        own = _require_mapping(given, where, STRUCTURES[name]) if given else {}
        structures[name] = _read_axes(own, f"{where}: ", STRUCTURES[name])
    common = _read_axes(content, f"{path}: ", COMMON)
    bags = _read_sets(path, "bags", content.get("bags"))
    validate = _read_sets(path, "validate", content["validate"]) if "validate" in content else {}
    count = len(bags) * sum(math.prod(map(len, {**own, **common}.values())) for own in structures.values())
    if count > MAX_CELLS:
        raise CampaignError(f"{path}: {count} cells; at most {MAX_CELLS}: drop some values")
    split, signals = content.get("split"), content.get("signals")
    if signals is not None:
        Field("signals", form="a signals file").check(signals, f"{path}: signals", CampaignError)
    return Campaign(
        source=path,
        bags=bags,
        validate=validate,
        structures=structures,
        common=common,
        limits=read_record(CellLimits, content.get("limits", {}), f"{path}: limits", CampaignError),
        split=(1.0 if validate else 0.75) if split is None else SPLIT.check(split, f"{path}: split", CampaignError),
        signals=_beside(path, signals) if signals else None,
        candidates=_load_candidates(path, structures.get(POLYNOMIAL.option, {})),
    )


def _require_mapping(value: Any, where: str, keys: Collection[str]) -> Mapping[str, Any]:
    if not isinstance(value, Mapping) or not value:
        raise CampaignError(f"{where} is {value!r}; expected a mapping with any of {', '.join(keys)}")
    require_known_keys(value, keys, where, CampaignError)
    return value


def _read_axes(given: Mapping[str, Any], where: str, axes: Mapping[str, Option]) -> dict[str, tuple[Setting, ...]]:
    """Return the values on each axis, by default one; a single value needs no brackets."""
    found = {}
    for key, axis in axes.items():
        values = given.get(key, axis.default)
        values = values if isinstance(values, list) else [values]
        found[key] = tuple(_require_different(values, f"{where}{key}"))
        for value in values if key in given else ():
            check_on_axis(axis, value, f"{where}{key}")
    return found


def check_on_axis(axis: Option, value: Any, where: str) -> None:
    """Raise CampaignError unless an axis can have the value; a text of an option, such as a size, may be a number."""
    if not (_may_be_auto(axis) and value == AUTO):
        axis.check(str(value) if axis.check_text is not None and type(value) is int else value, where, CampaignError)


def _read_sets(path: Path, key: str, sets: Any) -> dict[str, tuple[Path, ...]]:
    """Return sets of bags by name."""
    if not isinstance(sets, Mapping) or not sets:
        raise CampaignError(f"{path}: {key} is {sets!r}; expected sets of bags by name: {{road: [road_1, road_2]}}")
    found = {}
    for name, given in sets.items():
        if not _NAME.match(str(name)):
            raise CampaignError(f"{path}: {key}: name {name!r}; expected letters, digits and any of _ . + -")
        bags, where = [given] if isinstance(given, str) else given, f"{path}: {key}: {name}"
        if not isinstance(bags, list) or not all(isinstance(bag, str) and bag for bag in bags):
            raise CampaignError(f"{where} is {given!r}; expected a list of bags")
        found[str(name)] = tuple(_beside(path, bag) for bag in _require_different(bags, where))
    return found


def _require_different(values: list[Any], where: str) -> list[Any]:
    if not values:
        raise CampaignError(f"{where} is []; expected a value, or a list of values")
    for i, value in enumerate(values):
        if value in values[:i]:
            raise CampaignError(f"{where}: {value!r} is given twice; keep one")
    return values


def _beside(path: Path, name: str) -> Path:
    return path.parent / Path(name).expanduser()


def _load_candidates(path: Path, axes: Axes) -> dict[tuple[Any, Any], tuple[CandidateRules, str]]:
    """Return checked rules by method and name; raises CesError if they cannot be read or define too many candidates."""
    found = {}
    for method, name in product(axes.get("method", ()), axes.get("candidates", ())):
        file = None if name == BUILT_IN else _beside(path, str(name))
        rules = load_rules(file, str(method))
        try:
            rules.at_rate(NOMINAL_HZ).candidates()
        except CesError as error:
            raise CesError(f"{file}: {error}" if file else str(error)) from None
        text = file.read_bytes() if file else built_in_rules(str(method)).encode()
        found[method, name] = rules, hashlib.sha256(text).hexdigest()
    return found


def axis_schema(axis: Option) -> Schema:
    """Return the JSON Schema of an axis: a value, or a list of values without repetition."""
    one = {"type": ["string", "integer"]} if axis.check_text is not None else axis.bare_schema
    value = {"anyOf": [{"const": AUTO}, one]} if _may_be_auto(axis) else one
    several = {"type": "array", "items": value, "minItems": 1, "uniqueItems": True}
    about = f"{AUTO} or {axis.expected}" if _may_be_auto(axis) else axis.expected
    return {"anyOf": [value, several], "description": about}


def _may_be_auto(axis: Option) -> bool:
    return axis.kind is float and axis.default == AUTO


@dataclass(frozen=True)
class CampaignJob:
    """A cell with all its inputs except the recordings, which are sent separately.

    `recordings` are the bags to identify on, `validation` the pairs (set, bag) to validate on. `found` are the findings
    of the checks, in spite of which models are identified if they are ignored.
    """

    key: str
    cell: Cell
    limits: CellLimits
    split: float
    rules: CandidateRules | None
    recordings: tuple[Path, ...]
    validation: tuple[tuple[str, Path], ...]
    found: tuple[Finding, ...] = ()
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
    found: tuple[Finding, ...] = (),
    ignore_findings: bool = False,
) -> tuple[CampaignJob, ...]:
    """Return the job of each cell. `described` is the text of the recordings' signals description.

    A recording that a cell is identified on, or a copy of it, does not also validate it. The number of threads is not
    part of the key. Raises CesError if two cells are the same, or if a cell's recordings have seconds in common.
    """
    by_key: dict[str, CampaignJob] = {}
    for cell in campaign.cells():
        job = replace(_make_job(campaign, cell, recordings, described), found=found, ignore_findings=ignore_findings)
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
        if not any((same := shared_content(recordings[one], recordings[path])) and same.whole for one in mine)
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
