"""A value declared once: its unit, range, default and meaning, from which all else is made.

A `Field` checks a value, explains an error and gives a JSON Schema. A frozen dataclass whose fields are declared by
`quantity`, `choice` and `setting` is a record: a mapping, such as from YAML, goes in, and a checked record comes out.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from ces_observer.errors import CesError
from ces_observer.json_text import quote

T = TypeVar("T")
Schema = dict[str, Any]
LARGEST = sys.float_info.max
REQUIRED: Any = ...  # the default of a field that must be given
KINDS = {bool: "truth values", int: "whole numbers", float: "numbers", str: "texts", Path: "paths"}
ONE = {bool: "true or false", int: "a whole number", float: "a number", str: "a text", Path: "a path"}
JSON = {bool: "boolean", int: "integer", float: "number", str: "string", Path: "string"}


@dataclass(frozen=True)
class Field:
    """A value: a number in `unit` within [low, high], or (low, high] with `above`; one of the words `choices`; a text.

    `kind` is bool, int, float, str, Path, or a dataclass whose record it is; by default that of `default`. `many` is a
    list of such values, at least `min_count`. A text must pass `check_text`, which raises ValueError; `form`
    describes it.
    """

    name: str = ""
    default: Any = REQUIRED
    meaning: str = ""
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    above: bool = False
    choices: tuple[str, ...] = ()
    kind: Any = None
    many: bool = False
    min_count: int = 0
    form: str = ""
    check_text: Callable[[str], object] | None = None

    def __post_init__(self) -> None:
        first = self.default
        if isinstance(first, list | tuple):
            object.__setattr__(self, "many", True)
            first = first[0] if first else ""
        if self.kind is None:
            kind = Path if isinstance(first, Path) else type(first)
            object.__setattr__(self, "kind", str if first is None or first is REQUIRED else kind)

    @property
    def expected(self) -> str:
        """A phrase for the values that the field accepts."""
        if self.many:
            return f"a list of {KINDS.get(self.kind, 'mappings')}"
        if self.is_record:
            return "a mapping of keys to values"
        if self.form or self.choices:
            return self.form or "one of " + ", ".join(self.choices)
        return self.phrase(ONE[self.kind])

    def phrase(self, what: str) -> str:
        """Return `what`, such as "a number", with the range and the unit."""
        lower = f" {'above' if self.above else 'from'} {self.low:.10g}" if math.isfinite(self.low) else ""
        upper = f" to {self.high:.10g}" if math.isfinite(self.high) else ""
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        return f"{what}{lower}{upper}{unit if lower or upper else unit and ' in' + unit}"

    @property
    def described(self) -> str:
        """The meaning with the unit in brackets."""
        return f"{self.meaning} [{self.unit}]" if self.unit else self.meaning

    def check(self, value: Any, where: str = "", error: type[CesError] = CesError) -> Any:
        """Return the value, a whole number as a float where that is the kind; raises `error` beginning with `where`."""
        where = where or self.name
        if self.many:
            items = value if isinstance(value, Sequence) and not isinstance(value, str) else None
            if items is None or len(items) < self.min_count:
                raise error(f"{where} is {value!r}; expected {self.expected}")
            return [self.one.check(item, where, error) for item in items]
        if not self._accepts(value):
            raise error(f"{where} is {quote(value)}; expected {self.expected}")
        if self.check_text is not None:
            self._check_text(value, error, f"{where}: ")
        return float(value) if self.kind is float else value

    def parse(self, text: str) -> Any:
        """Return the value that a text on a command line stands for; raises CesError."""
        if self.check_text is not None:
            self._check_text(text, CesError)
        try:
            return self.check(self.kind(text))
        except (ValueError, CesError):
            raise CesError(f"found '{text}'; expected {self.expected}") from None

    def _check_text(self, text: str, error: type[CesError], where: str = "") -> None:
        try:
            assert self.check_text is not None
            self.check_text(text)
        except ValueError as reason:
            raise error(f"{where}{reason}") from None

    @property
    def is_record(self) -> bool:
        """Whether the value is a record, with fields of its own."""
        return is_dataclass(self.kind)

    @property
    def one(self) -> Field:
        """The field of one value of a list."""
        return replace(self, many=False, default=REQUIRED)

    def _accepts(self, value: Any) -> bool:
        if self.choices:
            return value in self.choices
        if self.kind in (bool, int):
            good = type(value) is self.kind
        elif self.kind is float:
            good = isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST
        else:
            good = isinstance(value, str | Path if self.kind is Path else str)
        if not good or self.kind not in (int, float):
            return good
        return bool(value <= self.high and (self.low < value if self.above else self.low <= value))

    @property
    def schema(self) -> Schema:
        """The JSON Schema (draft 7) of the value, with its default and meaning."""
        schema = self.bare_schema
        if self.default not in (REQUIRED, None):
            schema["default"] = list(self.default) if self.many else self.default
        return schema | ({"description": self.described} if self.meaning else {})

    @property
    def bare_schema(self) -> Schema:
        """The JSON Schema of the value alone."""
        if self.many:
            items = {"type": "array", "items": self.one.bare_schema}
            return items | ({"minItems": self.min_count} if self.min_count else {})
        if self.is_record:
            return record_schema(self.kind)
        if self.choices:
            return {"enum": list(self.choices)}
        schema: Schema = {"type": JSON[self.kind]}
        if math.isfinite(self.low):
            schema["exclusiveMinimum" if self.above else "minimum"] = self.low
        return schema | ({"maximum": self.high} if math.isfinite(self.high) else {})


def declare(made: Field) -> Any:
    """Declare a dataclass field by a Field; its name and kind are those in the class."""
    metadata = {"field": made}
    if made.default is REQUIRED:
        return field(metadata=metadata)
    return field(default=tuple(made.default) if made.many else made.default, metadata=metadata)


def quantity(
    default: Any, unit: str, meaning: str, low: float = -math.inf, high: float = math.inf, above: bool = False
) -> Any:
    """Declare a dataclass field: a number in `unit` inside [low, high], or (low, high] with `above`."""
    return declare(Field(default=default, unit=unit, meaning=meaning, low=low, high=high, above=above))


def choice(default: str, meaning: str, choices: tuple[str, ...]) -> Any:
    """Declare a dataclass field that is one of the words in `choices`."""
    return declare(Field(default=default, meaning=meaning, choices=choices))


def setting(default: Any, meaning: str) -> Any:
    """Declare a dataclass field that is a text, a truth value or a list of texts."""
    return declare(Field(default=default, meaning=meaning))


def record_fields(cls: Any) -> Mapping[str, Field]:
    """Return the fields of a dataclass by name, with the kinds of its annotations; a list of numbers is not empty."""
    return _find_fields(cls)


@cache
def _find_fields(cls: Any) -> Mapping[str, Field]:
    hints, known = get_type_hints(cls), {}
    for f in fields(cls):
        made, hint = f.metadata.get("field", Field()), hints[f.name]
        many = get_origin(hint) is tuple
        kind = next(kind for kind in get_args(hint) or (hint,) if kind not in (type(None), ...))
        default = f.default if f.default_factory is MISSING else f.default_factory()
        default = REQUIRED if default is MISSING else default
        at_least = 1 if many and kind is not str else made.min_count
        known[f.name] = replace(made, name=f.name, default=default, kind=kind, many=many, min_count=at_least)
    return known


def read_record(cls: type[T], values: object, where: str, error: type[CesError], base: T | None = None) -> T:
    """Return `cls(**values)` with every value checked against its field, records in it included.

    Keys that are missing have the values of `base`, if it is given. `where` begins every message, such as
    `sine.yaml: stroke`. Raises `error`.
    """
    if not isinstance(values, Mapping):
        raise error(f"{where}: expected a mapping of keys to values, found {values!r}")
    known = record_fields(cls)
    require_known_keys(values, known, where, error)
    found = {name: getattr(base, name) for name in known} if base is not None else {}
    for name, one in known.items():
        if name in values and one.is_record:
            found[name] = read_record(one.kind, values[name], f"{where}: {name}", error, found.get(name))
        elif name in values:
            checked = one.check(_without_quotes(one, values[name]), f"{where}: {name}", error)
            found[name] = tuple(checked) if one.many else checked
        elif base is None and one.default is REQUIRED:
            raise error(f"{where}: '{name}' is missing; expected {one.expected}")
    try:
        return cls(**found)
    except error as reason:  # of values that do not fit together
        raise error(f"{where}: {reason}") from None


def require_known_keys(
    values: Mapping[str, Any], known: Collection[str], where: str, error: type[CesError] = CesError
) -> None:
    """Raise `error` at the first key of a mapping that is not `known`."""
    for key in values:
        if key not in known:
            raise error(f"{where}: unknown key '{key}'; known are {', '.join(known)}")


def _without_quotes(one: Field, value: Any) -> Any:
    """Return a number that YAML reads as text, such as 1e6, as a number, and 2.0 as a whole number if that is asked."""
    if isinstance(value, list | tuple):
        return [_without_quotes(one.one, item) for item in value]
    if one.kind not in (int, float) or not isinstance(value, str | float):
        return value
    try:
        number = float(value)
    except ValueError:
        return value
    if not math.isfinite(number):
        return value
    return int(number) if one.kind is int and number.is_integer() else number


def record_schema(cls: type[Any], partial: bool = False) -> Schema:
    """Return the JSON Schema of a mapping that `read_record` reads; with `partial` (a `base`), no key is required."""
    known = record_fields(cls)
    properties = {
        name: record_schema(one.kind, partial) if one.is_record else one.schema for name, one in known.items()
    }
    schema: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    required = [name for name, one in known.items() if one.default is REQUIRED and not partial]
    about = (cls.__doc__ or "").split("\n\n", maxsplit=1)[0].split("; raises", maxsplit=1)[0].replace("\n    ", " ")
    return schema | ({"required": required} if required else {}) | {"description": about.strip()}


def walk_record(record: Any, prefix: str = "") -> Iterator[tuple[str, Any, Field]]:
    """Yield the path, value and field of every value in a record, such as `seal.coulomb_N`."""
    for name, one in record_fields(type(record)).items():
        value = getattr(record, name)
        if is_dataclass(value):
            yield from walk_record(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value, one
