"""The layout of a dyno's log: a small YAML file in, a checked `DynoMapping` out."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

from ces_data.config_file import packaged_text, parse_yaml_mapping, read_yaml_mapping
from ces_data.log_formats import LOG_FORMATS
from ces_data.units import QUANTITIES, TABLE, ask_for_amperes, find_unit
from ces_observer.errors import CesError
from ces_observer.fields import Field, Schema
from ces_observer.records import OneOf, choice, in_files, part, read_record
from ces_observer.shapes import ByName
from ces_observer.signals import NAMES

WHAT = "a mapping for ces import; ces import --template prints one"
ONE_TIME = "give one of 'time' and 'rate'"
SCALING = "value in SI units = scale * cell + offset"
KNOWN = "give its column, or a constant if it is known"

TEMPLATE = packaged_text("ces_data.logs", "template.yaml").replace("FORMATS", "one of " + ", ".join(LOG_FORMATS))


class MappingError(CesError):
    """A mapping file that cannot be used."""


def _require_one_character(text: str) -> None:
    if len(text) != 1:
        raise ValueError(f"found {text!r}; expected one character")


def _require_date(text: str) -> None:
    if "%" not in text:
        raise ValueError(f'{text!r}; expected a pattern of a date, such as "%d/%m/%Y %H:%M:%S.%f"')


def _compile(text: str) -> re.Pattern[str]:
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise ValueError(f"{text!r}; expected a regular expression ({error})") from None
    if not pattern.groups:
        raise ValueError(f'{text!r}; expected a regular expression with a group, such as "_([0-9.]+)A"')
    return pattern


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """How a number becomes one in SI units, by its unit, or by scale and offset."""

    unit: str = part(default="", meaning="unit of the column, instead of scale and offset")
    given_scale: float | None = part(key="scale", default=None, meaning=SCALING, rules={"not": {"const": 0}})
    given_offset: float | None = part(key="offset", default=None, meaning=SCALING)
    schema_rules: ClassVar[Schema] = {
        "not": {"required": ["unit"], "anyOf": [{"required": ["scale"]}, {"required": ["offset"]}]}
    }

    @property
    def scaled(self) -> bool:
        """Whether the mapping says it; otherwise the log's own unit counts, if it states one."""
        return bool(self.unit) or (self.given_scale, self.given_offset) != (None, None)

    @property
    def scale(self) -> float:
        """The factor."""
        unit = find_unit(self.unit) if self.unit else None
        return unit.scale if unit else 1.0 if self.given_scale is None else self.given_scale

    @property
    def offset(self) -> float:
        """What is added."""
        unit = find_unit(self.unit) if self.unit else None
        return unit.offset if unit else self.given_offset or 0.0

    def check_for(self, name: str) -> None:
        """Raise MappingError for a scale of zero, and for a unit that is not the signal's, or not alone."""
        if self.given_scale == 0.0:
            raise MappingError("scale is 0; expected the factor from the logged unit to SI")
        unit, quantities = find_unit(self.unit) if self.unit else None, QUANTITIES.get(name, ())
        alone = (self.given_scale, self.given_offset) == (None, None)
        if name == "current" and unit is not None and unit.quantity == "voltage":
            raise MappingError(f"unit is {self.unit!r}, {ask_for_amperes(unit)}")
        if self.unit and (unit is None or unit.quantity not in quantities or not alone):
            units = ", ".join(unit for quantity in quantities if quantity != "voltage" for unit in TABLE[quantity])
            raise MappingError(f"unit is {self.unit!r}; expected {units}{', without scale and offset' * (not alone)}")


@dataclass(frozen=True)
class LogColumn(Scaling):
    """A column of the table by name or number (from 0).

    `group` selects one of several channels of the name, `date` is the pattern of a time as text.
    """

    key: str | int = part(key="column", low=0, form="a name, or a number from 0", meaning="its name or number")
    group: str | int | None = part(default=None, meaning="number or name of a channel group or bus")
    date: str = part(default="", check_text=_require_date, meaning='pattern of a date, such as "%d/%m/%Y %H:%M:%S.%f"')
    delay: float = part(default=0.0, meaning="[s] taken off its stamps")

    @property
    def delay_ns(self) -> int:
        """The same in whole nanoseconds."""
        return round(1e9 * self.delay)


@dataclass(frozen=True)
class FixedValue:
    """A value that is the same in all rows of all files."""

    value: float = part(key="constant", meaning="the same value in all rows")


@dataclass(frozen=True)
class FileNameValue(Scaling):
    """A number in the file's name, the first group of `pattern`."""

    pattern: re.Pattern[str] = part(
        key="from_name", make=_compile, meaning="the first group, found in the file's name", rules={"format": "regex"}
    )


Source = LogColumn | FixedValue | FileNameValue
SIGNALS = ByName(
    Field(kind=OneOf({"column": LogColumn, "constant": FixedValue, "from_name": FileNameValue}, tag=""), remedy=KNOWN),
    NAMES,
    ("current", "force"),
)


@dataclass(frozen=True)
class DynoMapping:
    """The layout of a log, with either `time` [s] or `rate` [Hz], or neither if its channels have their own times.

    `delimiter`, `decimal` and `header_lines` are found from the file if they are None. `signals` maps each signal to
    its source; it always includes current and force, and position or speed.
    """

    signals: Mapping[str, Source] = part(kind=SIGNALS, inline=True)
    time: LogColumn | None = part(default=None, meaning="[s] after scaling", form="a mapping with its column")
    rate: float | LogColumn | None = part(
        default=None, low=0.0, above=True, meaning="[Hz], instead of time", form="a rate above 0 Hz, or {column: NAME}"
    )
    format: str = choice("", "left out, the file's suffix decides", tuple(LOG_FORMATS))
    delimiter: str | None = part(
        default=None, check_text=_require_one_character, meaning="between the cells of a CSV file"
    )
    decimal: str | None = choice(None, "mark in the numbers of a CSV file", (".", ","))
    header_lines: int | None = part(default=None, low=0, meaning="lines before the first row of numbers")
    names: tuple[str, ...] = part(
        default=(), kind=(str, float), make=lambda names: tuple(map(str, names)), meaning="names for the columns"
    )
    rows: str = part(
        default="",
        meaning="where the table is in a JSON or MAT file, or block(2) of a text table",
        form="a path such as results.data",
    )
    blank: str = choice("error", "a blank cell: a mistake, or a sample that was not taken", ("error", "missing"))
    dbc: tuple[Path, ...] = part(
        default=(), kind=Path, meaning="databases of a CAN log (.dbc)", rules={"type": ["string", "array"]}
    )
    source: str = field(default="", metadata=in_files(None))
    schema_rules: ClassVar[Schema] = {
        "anyOf": [{"required": ["position"]}, {"required": ["speed"]}], "not": {"required": ["time", "rate"]}
    }  # fmt: skip

    def list_columns(self) -> list[LogColumn]:
        """Return the columns of the time and of all signals."""
        return [source for source in (self.time, *self.signals.values()) if isinstance(source, LogColumn)]

    def checked(self) -> Self:
        """Return it; raises MappingError unless there is a motion, and the units fit."""
        if not {"position", "speed"} & self.signals.keys():
            raise MappingError(f"key 'position' is missing; {KNOWN}, or that of the speed")
        if self.time is not None and self.rate is not None:
            raise MappingError(ONE_TIME)
        for name, source in (*self.signals.items(), ("time", self.time), ("rate", self.rate)):
            if isinstance(source, Scaling):
                try:
                    source.check_for(name)
                except MappingError as error:
                    raise MappingError(f"{name}: {error}") from None
            if isinstance(source, LogColumn) and source.delay and name not in NAMES:
                raise MappingError(f"{name}: delay is {source.delay:g}; expected it for signals only")
            if isinstance(source, LogColumn) and source.date and name != "time":
                raise MappingError(f"{name}: date is {source.date!r}; expected it for the time only")
        return self


def load_dyno_mapping(path: Path) -> DynoMapping:
    """Read a mapping file; raises MappingError naming the file and the key."""
    return _make_mapping(path, read_yaml_mapping(path, WHAT, error=MappingError))


def parse_dyno_mapping(text: str, source: str) -> DynoMapping:
    """Return the mapping in a text, as `load_dyno_mapping` does; `source` begins each error."""
    return _make_mapping(Path(source), parse_yaml_mapping(text, source, WHAT, error=MappingError))


def _make_mapping(path: Path, content: Mapping[str, Any]) -> DynoMapping:
    if "/**" in content or any(isinstance(part, Mapping) and "topic" in part for part in content.values()):
        remedy = "--mapping takes a mapping of columns, which 'ces import LOG --propose' writes"
        raise MappingError(f"{path}: is a signals file (--signals); {remedy}")
    dbc = content.get("dbc", [])
    content = {**content, "dbc": [dbc] if isinstance(dbc, str) else dbc}
    mapping = read_record(DynoMapping, content, str(path), MappingError)
    return replace(mapping, source=str(path), dbc=tuple(path.parent / name for name in mapping.dbc))


def parse_mapping_without_force(content: Mapping[str, Any], source: str) -> DynoMapping:
    """Return the mapping with this content, which need not have a force, as a file must; raises MappingError."""
    mapping = parse_dyno_mapping(json.dumps({**content, "force": content.get("force", {"constant": 0.0})}), source)
    signals = {name: signal for name, signal in mapping.signals.items() if name in content or name != "force"}
    return replace(mapping, signals=signals)
