"""The layout of a dyno's log: a small YAML file in, a checked `DynoMapping` out."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_identify.config_file import read_yaml_mapping
from ces_observer.errors import CesError
from ces_observer.signals import NAMES, UNITS

FORMATS = ("csv", "json", "mat")
SOURCES = ("column", "constant", "from_name")
LAYOUT_KEYS = ("format", "delimiter", "decimal", "header_lines", "names", "rows", "time", "rate")

TEMPLATE = """\
# How `ces import` reads a dyno's log. Every signal is value in SI units = scale * cell + offset.
# Position [m] and force [N] are positive in compression; use a negative scale where the log has it the other way.

# format: csv           # csv, json or mat; left out, the file's suffix decides (.csv .txt .dat .tsv, .json, .mat)

# For csv:
# delimiter: ","        # "\\t" for a tab
# decimal: "."          # "," if the log writes 3,14
# header_lines: 1       # lines before the first row of numbers; the last of them names the columns.
                        # Left out: 1 if the first line has a cell that is not a number, else 0
# names: [t, x, F]      # names for the columns, instead of those in the file

# For json and mat:
# rows: data            # where the table is, a path such as results.data; a matrix, a list of rows, or columns by name

# Time: one of these three. A column is given by its name or by its number, from 0.
time: {column: t_s, scale: 1.0}    # [s] after scaling
# rate: 1000.0                     # [Hz], for a log without time or with one that is too coarse
# rate: {column: fs}               # [Hz], from the first row

position: {column: x_mm, scale: 0.001}
current: {column: current_A}
# current: {constant: 0.0}                                # a passive damper
# current: {from_name: "_([0-9.]+)A", scale: 1.0}         # the first group, found in the file's name
force: {column: F_N}
# temperature: {column: T_oil, offset: -273.15}           # [degC]
# speed: {column: v_mm_s, scale: 0.001}                   # [m/s], measured; it also needs a topic in the signals file
# acceleration: {column: a_g, scale: 9.80665}             # [m/s2], of the piston relative to the cylinder; likewise
"""


class MappingError(CesError):
    """A mapping file that cannot be used."""


@dataclass(frozen=True)
class Column:
    """A column of the table by name or number (from 0); value = scale * cell + offset."""

    key: str | int
    scale: float = 1.0
    offset: float = 0.0


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


Source = Column | FixedValue | FileNameValue


@dataclass(frozen=True)
class DynoMapping:
    """The layout of a log, with either `time` [s] or `rate` [Hz].

    `signals` maps each signal to the source of its values; it always includes position, current and force.
    """

    source: str
    signals: Mapping[str, Source]
    time: Column | None = None
    rate: float | Column | None = None
    format: str = ""
    delimiter: str = ","
    decimal: str = "."
    header_lines: int | None = None
    names: tuple[str, ...] = ()
    rows: str = ""


def load_dyno_mapping(path: Path) -> DynoMapping:
    """Read a mapping file; raises MappingError naming the file and the key."""
    what = "a mapping for ces import; ces import --template prints one"
    content = read_yaml_mapping(path, what, (*LAYOUT_KEYS, *NAMES), MappingError)
    for name in ("position", "current", "force"):
        if name not in content:
            raise MappingError(f"{path}: no '{name}'; give its column, or a constant if it is known")
    if ("time" in content) == ("rate" in content):
        raise MappingError(f"{path}: give one of 'time' and 'rate'")
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
        if sum(key in content for key in SOURCES) != 1:
            raise self._error(name, content, f"one of column, constant and from_name, in {UNITS[name]} after scaling")
        if "constant" in content:
            return FixedValue(self._number(content["constant"], name, "a finite number"))
        if "from_name" in content:
            return FileNameValue(self._pattern(content["from_name"], name), *self._scaling(content, name))
        return self.column(name)

    def column(self, name: str) -> Column:
        content = self._mapping(name)
        key = content.get("column")
        if isinstance(key, bool) or not isinstance(key, str | int) or (isinstance(key, int) and key < 0):
            raise self._error(name, key, "column: a name, or a number from 0")
        return Column(key, *self._scaling(content, name))

    def rate(self) -> float | Column:
        value = self.content["rate"]
        if isinstance(value, Mapping):
            return self.column("rate")
        rate = self._number(value, "rate", "a rate in Hz, or {column: NAME}")
        if rate <= 0.0:
            raise self._error("rate", value, "a rate in Hz greater than 0")
        return rate

    def layout(self) -> dict[str, Any]:
        """Return the file's format settings, where the mapping has them."""
        get = self.content.get
        delimiter, header_lines = get("delimiter"), get("header_lines")
        rules: dict[str, tuple[bool, str]] = {
            "format": (get("format") in FORMATS, f"one of {', '.join(FORMATS)}"),
            "delimiter": (isinstance(delimiter, str) and len(delimiter) == 1, "one character"),
            "decimal": (get("decimal") in (".", ","), "'.' or ','"),
            "header_lines": (isinstance(header_lines, int) and header_lines >= 0, "0 or more"),
            "names": (isinstance(get("names"), list), "a list of names"),
            "rows": (isinstance(get("rows"), str), "a path such as results.data"),
        }
        layout = {key: self.content[key] for key in rules if key in self.content}
        for key, value in layout.items():
            if not rules[key][0]:
                raise self._error(key, value, rules[key][1])
        return layout | ({"names": tuple(map(str, layout["names"]))} if "names" in layout else {})

    def _mapping(self, name: str) -> Mapping[str, Any]:
        content, keys = self.content[name], (*SOURCES, "scale", "offset")
        if not isinstance(content, Mapping) or not set(content) <= set(keys):
            raise self._error(name, content, f"a mapping of {', '.join(keys)}")
        return content

    def _scaling(self, content: Mapping[str, Any], name: str) -> tuple[float, float]:
        scale = self._number(content.get("scale", 1.0), name, "scale: a finite number other than 0")
        if scale == 0.0:
            raise self._error(name, 0, "scale: a finite number other than 0")
        return scale, self._number(content.get("offset", 0.0), name, "offset: a finite number")

    def _pattern(self, text: object, name: str) -> re.Pattern[str]:
        try:
            pattern = re.compile(str(text))
        except re.error as error:
            raise self._error(name, text, f"a regular expression ({error})") from None
        if pattern.groups < 1:
            raise self._error(name, text, 'a regular expression with a group, such as "_([0-9.]+)A"')
        return pattern

    def _number(self, value: object, name: str, expected: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._error(name, value, expected)
        return float(value)

    def _error(self, name: str, value: object, expected: str) -> MappingError:
        return MappingError(f"{self.path}: '{name}' is {value!r}; expected {expected}")
