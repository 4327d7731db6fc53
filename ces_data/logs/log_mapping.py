"""The layout of a dyno's log: a small YAML file in, a checked `DynoMapping` out."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_data.config_file import packaged_text, parse_yaml_mapping, read_yaml_mapping
from ces_data.log_formats import LOG_FORMATS
from ces_data.units import QUANTITIES, find_unit
from ces_observer.errors import CesError
from ces_observer.fields import Field, require_known_keys
from ces_observer.signals import NAMES, UNITS

WHAT = "a mapping for ces import; ces import --template prints one"
ONE_TIME = "give one of 'time' and 'rate'"
SOURCES = ("column", "constant", "from_name")
COLUMN_KEYS = ("unit", "group", "date")


def _require_one_character(text: str) -> None:
    if len(text) != 1:
        raise ValueError(f"found {text!r}; expected one character")


LAYOUT: Mapping[str, Field] = {  # of a log: its form, which the first lines tell as well
    one.name: one
    for one in (
        Field("format", meaning="left out, the file's suffix decides", choices=tuple(LOG_FORMATS)),
        Field("delimiter", meaning="between the cells of a CSV file", check_text=_require_one_character),
        Field("decimal", meaning="mark in the numbers of a CSV file", choices=(".", ",")),
        Field("header_lines", meaning="lines before the first row of numbers", low=0, kind=int),
        Field("names", meaning="names for the columns", many=True),
        Field("rows", meaning="where the table is in a JSON or MAT file", form="a path such as results.data"),
        Field("blank", meaning="a blank cell: a mistake, or a sample that was not taken", choices=("error", "missing")),
        Field("dbc", meaning="databases of a CAN log (.dbc)", many=True),
    )
}
LAYOUT_KEYS = (*LAYOUT, "time", "rate")

TEMPLATE = packaged_text("ces_data.logs", "template.yaml").replace("FORMATS", "one of " + ", ".join(LOG_FORMATS))


class MappingError(CesError):
    """A mapping file that cannot be used."""


@dataclass(frozen=True)
class LogColumn:
    """A column of the table by name or number (from 0); value = scale * cell + offset.

    `scaled` is true if the mapping gives scale, offset or unit; otherwise the log's own unit counts, if it states one.
    `group` selects one of several channels of the name, `date` is the pattern of a time as text.
    """

    key: str | int
    scale: float = 1.0
    offset: float = 0.0
    scaled: bool = False
    group: str | int | None = None
    date: str = ""
    unit: str = ""


@dataclass(frozen=True)
class FixedValue:
    """A value that is the same in all rows of all files."""

    value: float


@dataclass(frozen=True)
class FileNameValue:
    """A number in the file's name, the first group of `pattern`; value = scale * number + offset."""

    pattern: re.Pattern[str]
    scale: float = 1.0
    offset: float = 0.0


Source = LogColumn | FixedValue | FileNameValue


@dataclass(frozen=True)
class DynoMapping:
    """The layout of a log, with either `time` [s] or `rate` [Hz], or neither if its channels have their own times.

    `delimiter`, `decimal` and `header_lines` are found from the file if they are None. `signals` maps each signal to
    its source; it always includes current and force, and position or speed.
    """

    source: str
    signals: Mapping[str, Source]
    time: LogColumn | None = None
    rate: float | LogColumn | None = None
    format: str = ""
    delimiter: str | None = None
    decimal: str | None = None
    header_lines: int | None = None
    names: tuple[str, ...] = ()
    rows: str = ""
    blank: str = "error"
    dbc: tuple[Path, ...] = ()


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
    require_known_keys(content, (*LAYOUT_KEYS, *NAMES), str(path), MappingError)
    for name in ("position", "current", "force"):
        if name not in content and not (name == "position" and "speed" in content):
            raise MappingError(f"{path}: no '{name}'; give its column, or a constant if it is known")
    if "time" in content and "rate" in content:
        raise MappingError(f"{path}: {ONE_TIME}")
    reader = _Reader(path, content)
    return DynoMapping(
        source=str(path),
        signals={name: reader.source(name) for name in NAMES if name in content},
        time=reader.column("time") if "time" in content else None,
        rate=reader.rate() if "rate" in content else None,
        **reader.layout(),
    )


class _Reader:
    """Checks the values under the keys of a mapping file."""

    def __init__(self, path: Path, content: Mapping[str, Any]) -> None:
        self.path, self.content = path, content

    def source(self, name: str) -> Source:
        content = self._mapping(name)
        expected = f"one of column, constant and from_name, in {UNITS[name]} after scaling"
        self._require(sum(key in content for key in SOURCES) == 1, name, content, expected)
        if "constant" in content:
            return FixedValue(self._number(content["constant"], name, "a finite number"))
        if "column" in content:
            return self.column(name)
        text = content["from_name"]
        try:
            pattern = re.compile(str(text))
        except re.error as error:
            raise self._error(name, text, f"a regular expression ({error})") from None
        self._require(pattern.groups > 0, name, text, 'a regular expression with a group, such as "_([0-9.]+)A"')
        return FileNameValue(pattern, *self._scaling(content, name))

    def column(self, name: str) -> LogColumn:
        content = self._mapping(name)
        key: Any = content.get("column")
        group, date = content.get("group"), content.get("date", "")
        known = isinstance(key, str) or (type(key) is int and key >= 0)
        self._require(known, name, key, "column: a name, or a number from 0")
        scale, offset = self._scaling(content, name)
        known = group is None or isinstance(group, str) or type(group) is int
        self._require(known, name, group, "group: the number or name of a channel group or bus")
        known = isinstance(date, str) and (not date or (name == "time" and "%" in date))
        self._require(known, name, date, 'date: a pattern such as "%d/%m/%Y %H:%M:%S.%f", for time only')
        scaled = not content.keys().isdisjoint(("scale", "offset", "unit"))
        return LogColumn(key, scale, offset, scaled, group, date, str(content.get("unit", "")))

    def rate(self) -> float | LogColumn:
        value = self.content["rate"]
        if isinstance(value, Mapping):
            return self.column("rate")
        rate = self._number(value, "rate", "a rate in Hz, or {column: NAME}")
        self._require(rate > 0.0, "rate", value, "a rate in Hz greater than 0")
        return rate

    def layout(self) -> dict[str, Any]:
        """Return the file's format settings, where the mapping has them."""
        given = {key: self.content[key] for key in LAYOUT if key in self.content}
        if isinstance(given.get("dbc"), str):
            given["dbc"] = [given["dbc"]]
        if isinstance(given.get("names"), list):
            given["names"] = list(map(str, given["names"]))
        layout = {key: LAYOUT[key].check(value, f"{self.path}: '{key}'", MappingError) for key, value in given.items()}
        files = {"dbc": tuple(self.path.parent / name for name in layout["dbc"])} if "dbc" in layout else {}
        return {**layout, **({"names": tuple(layout["names"])} if "names" in layout else {}), **files}

    def _mapping(self, name: str) -> Mapping[str, Any]:
        content, keys = self.content[name], (*SOURCES, "scale", "offset", *COLUMN_KEYS)
        known = isinstance(content, Mapping) and set(content) <= set(keys)
        self._require(known, name, content, f"a mapping of {', '.join(keys)}")
        found: Mapping[str, Any] = content
        return found

    def _scaling(self, content: Mapping[str, Any], name: str) -> tuple[float, float]:
        if "unit" not in content:
            scale = self._number(content.get("scale", 1.0), name, "scale: a finite number other than 0")
            self._require(scale != 0.0, name, 0, "scale: a finite number other than 0")
            return scale, self._number(content.get("offset", 0.0), name, "offset: a finite number")
        text, quantities = content["unit"], QUANTITIES.get(name, ())
        unit = find_unit(text) if isinstance(text, str) else None
        if unit is None or unit.quantity not in quantities or not content.keys().isdisjoint(("scale", "offset")):
            raise self._error(name, text, f"unit: of a {' or '.join(quantities)}, without scale and offset")
        return unit.scale, unit.offset

    def _number(self, value: Any, name: str, expected: str) -> float:
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        self._require(number, name, value, expected)
        return float(value)

    def _require(self, good: bool, name: str, value: object, expected: str) -> None:
        if not good:
            raise self._error(name, value, expected)

    def _error(self, name: str, value: object, expected: str) -> MappingError:
        return MappingError(f"{self.path}: '{name}' is {value!r}; expected {expected}")
