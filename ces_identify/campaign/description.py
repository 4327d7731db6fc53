"""A campaign's description: a YAML file in, a checked `Campaign` out; paths in the file are relative to its folder."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ces_data.config_file import read_yaml_mapping
from ces_identify.campaign.axes import COMMON, STRUCTURES, describe_axis, is_on_axis
from ces_identify.campaign.plan import BUILT_IN, BUILT_IN_THESIS, Campaign, Candidates, CellLimits, Setting
from ces_identify.options import SPLIT
from ces_identify.polynomial.regressors import built_in_rules, load_rules
from ces_identify.polynomial.search_limits import BOTH, THESIS
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer.errors import CesError
from ces_observer.fields import read_record, require_known_keys
from ces_observer.options import Option

KEYS = ("bags", "validate", "structures", *COMMON, "limits", "split", "signals")
MAX_CELLS = 100_000
NOMINAL_HZ = 1000.0  # rate for counting candidates
_NAME = re.compile(r"[\w.+-]+\Z")


class CampaignError(CesError):
    """A campaign that cannot be run."""


def load_campaign(path: Path) -> Campaign:
    """Read a campaign file; raises CampaignError, or CesError about a file with candidate rules."""
    content = read_yaml_mapping(path, "a campaign with bags and structures", KEYS, CampaignError)
    return _Reader(path, content).campaign()


class _Reader:
    """Checks the values under the keys of a campaign file."""

    def __init__(self, path: Path, content: Mapping[str, Any]) -> None:
        self.path, self.content = path, content

    def campaign(self) -> Campaign:
        if "structures" not in self.content:
            raise CampaignError(f"{self.path}: no 'structures'; expected some of {', '.join(STRUCTURES)}")
        structures = self._structures(self.content["structures"])
        validate = self._sets("validate") if "validate" in self.content else {}
        common = {key: self._axis("", key, axis, self.content) for key, axis in COMMON.items()}
        campaign = Campaign(
            source=self.path,
            bags=self._sets("bags"),
            validate=validate,
            structures=structures,
            common=common,
            limits=read_record(CellLimits, self.content.get("limits", {}), f"{self.path}: limits", CampaignError),
            split=self._one(SPLIT, 1.0 if validate else 0.75),
            signals=self._signals(),
            candidates=self._candidates(structures),
        )
        self._require_size(campaign)
        return campaign

    def _sets(self, key: str) -> dict[str, tuple[Path, ...]]:
        sets = self.content.get(key)
        if not isinstance(sets, Mapping) or not sets:
            raise self._wrong(key, sets, "sets of bags by name, such as {road: [road_1, road_2]}")
        for name in sets:
            if not _NAME.match(str(name)):
                raise CampaignError(f"{self.path}: {key}: name {name!r}; expected letters, digits and any of _ . + -")
        return {str(name): self._bags(f"{key}: {name}", paths) for name, paths in sets.items()}

    def _bags(self, where: str, value: Any) -> tuple[Path, ...]:
        paths = [value] if isinstance(value, str) else value
        if not isinstance(paths, list) or not paths or not all(isinstance(p, str) and p for p in paths):
            raise self._wrong(where, value, "a list of bags")
        self._require_different(where, paths)
        return tuple(self._resolve_path(path) for path in paths)

    def _structures(self, content: Any) -> dict[str, dict[str, tuple[Setting, ...]]]:
        if not content:
            raise self._wrong("structures", content, f"a mapping with some of {', '.join(STRUCTURES)}")
        self._require_mapping("structures", content, STRUCTURES)
        return {str(name): self._structure(str(name), axes) for name, axes in content.items()}

    def _structure(self, name: str, content: Any) -> dict[str, tuple[Setting, ...]]:
        where, axes, values = f"structures: {name}", STRUCTURES[name], {} if content is None else content
        self._require_mapping(where, values, axes)
        return {key: self._axis(f"{where}: ", key, axis, values) for key, axis in axes.items()}

    def _axis(self, where: str, key: str, axis: Option, content: Mapping[str, Any]) -> tuple[Setting, ...]:
        """Return the values on an axis; a single value needs no brackets."""
        if key not in content:
            return (axis.default,)
        values = content[key] if isinstance(content[key], list) else [content[key]]
        if not values or not all(is_on_axis(axis, value) for value in values):
            raise self._wrong(f"{where}{key}", content[key], f"one or a list of: {describe_axis(axis)}")
        self._require_different(f"{where}{key}", values)
        return tuple(values)

    def _one(self, option: Option, default: Any) -> Any:
        found = self.content.get(option.name)
        return default if found is None else option.check(found, f"{self.path}: {option.name}", CampaignError)

    def _signals(self) -> Path | None:
        name = self._one(Option("signals", None, form="a signals file"), None)
        return self._resolve_path(name) if name else None

    def _candidates(self, structures: Mapping[str, Mapping[str, tuple[Setting, ...]]]) -> dict[str, Candidates]:
        axes = structures.get(POLYNOMIAL.option, {})
        names = map(str, axes.get("candidates", ()))
        named = {name: _load_candidates(None if name == BUILT_IN else self._resolve_path(name)) for name in names}
        by_thesis = {BUILT_IN_THESIS: _load_candidates(None, THESIS)} if THESIS in axes.get("method", ()) else {}
        return {**named, **by_thesis}

    def _require_size(self, campaign: Campaign) -> None:
        """Raise CampaignError if there are too many cells."""
        count = math.prod(map(len, campaign.common.values())) * len(campaign.bags)
        count *= sum(math.prod(map(len, axes.values())) for axes in campaign.structures.values())
        if count > MAX_CELLS:
            raise CampaignError(f"{self.path}: {count} cells; at most {MAX_CELLS}: drop some values")

    def _resolve_path(self, name: str) -> Path:
        return self.path.parent / Path(name).expanduser()

    def _require_mapping(self, where: str, value: Any, keys: Collection[str]) -> None:
        if not isinstance(value, Mapping):
            raise self._wrong(where, value, f"a mapping with any of {', '.join(keys)}")
        require_known_keys(value, keys, f"{self.path}: {where}", CampaignError)

    def _require_different(self, where: str, values: list[Any]) -> None:
        for i, value in enumerate(values):
            if value in values[:i]:
                raise CampaignError(f"{self.path}: {where}: {value!r} is given twice; keep one")

    def _wrong(self, where: str, value: object, expected: str) -> CampaignError:
        return CampaignError(f"{self.path}: {where} is {value!r}; expected {expected}")


def _load_candidates(path: Path | None, method: str = BOTH) -> Candidates:
    """Return checked rules; raises CesError if they cannot be read or define too many candidates."""
    rules = load_rules(path, method)
    try:
        rules.at_rate(NOMINAL_HZ).candidates()
    except CesError as error:
        raise CesError(f"{path}: {error}" if path else str(error)) from None
    text = built_in_rules(method).encode() if path is None else path.read_bytes()
    return Candidates(rules, hashlib.sha256(text).hexdigest())
