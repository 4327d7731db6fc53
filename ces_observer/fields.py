"""A value declared once: its unit, range, default and meaning, from which all else is made.

A `Field` reads and writes a value, explains an error and gives a JSON Schema. `ces_observer.records` makes records of
fields; their lists, choices and values by name are each a `ValueShape`.
"""

from __future__ import annotations

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError, suggest
from ces_observer.json_text import quote

Schema = dict[str, Any]
LARGEST = sys.float_info.max
REQUIRED: Any = ...  # the default of a field that must be given
NAMES: dict[Any, tuple[str, str, str]] = {  # of kinds: one, several, and in a schema
    bool: ("true or false", "truth values", "boolean"),
    int: ("a whole number", "whole numbers", "integer"),
    float: ("a number", "numbers", "number"),
    str: ("a text", "texts", "string"),
    Path: ("a path", "paths", "string"),
    Mapping: ("a mapping of keys to values", "mappings", "object"),
}


class FieldError(Exception):
    """What is wrong with a value: its place within the whole, such as `terms[0]: lag`, and the words after that."""

    def __init__(self, words: str, place: str = "") -> None:
        super().__init__(words)
        self.words, self.place = words, place

    def inside(self, key: str) -> FieldError:
        """Return the error as one of the whole, in which the value is under `key`: a name, or [3]."""
        return FieldError(self.words, _join(key, self.place))


def _join(outer: str, inner: str) -> str:
    return f"{outer}: {inner}" if outer and inner and inner[0] != "[" else outer + inner


@contextmanager
def explaining(where: str, error: type[CesError]) -> Iterator[None]:
    """Raise `error` in one line that begins with `where` for a FieldError inside the block."""
    try:
        yield
    except FieldError as reason:
        raise error(_join(where, reason.place) + reason.words) from None


class ValueShape(ABC):
    """How a value is made of others, such as a record: a kind of field. `expected` and `several` are its words.

    Keys that a record lacks are those of `base`, if it is given, else their defaults; of a `complete` file, which a
    program wrote, only optional keys may be missing.
    """

    expected: str = NAMES[Mapping][0]
    several: str = NAMES[Mapping][1]

    def accepts(self, value: Any) -> bool:
        """Return whether the value is of its type, as a mapping is."""
        return isinstance(value, Mapping)

    @abstractmethod
    def read(self, value: Any, base: Any = None, complete: bool = False) -> Any:
        """Return the checked value; raises FieldError."""

    @abstractmethod
    def write(self, value: Any) -> Any:
        """Return the value as a file has it."""

    @property
    @abstractmethod
    def schema(self) -> Schema:
        """The JSON Schema (draft 7) of what `read` accepts."""


@dataclass(frozen=True)
class Field(ValueShape):
    """A value: a number in `unit` within [low, high], or (low, high] with `above`; one of the words `choices`; a text.

    A number may be one of the words `also` instead. `kind` is bool, int, float, str, Path, Mapping, object (anything),
    several of these, or a ValueShape, such as another field; by default that of `default`. `many` is a list of such
    values, `min_count` to `max_count` of them, `ordered` one that does not fall, `different` one without repetition;
    with `or_one`, a value alone stands for a list of it. A text must pass `check_text`, which raises ValueError; `form`
    describes the value, `remedy` says what to do about a mistake.

    In files, `key` is its name if it has another one there, and `null` stands for None. `make` turns what is read into
    the value and raises ValueError; `text` turns it back. An `optional` value is left out while it has its default; one
    with `when` is there only if the others' values say so. The keys of an `inline` record stand beside it. `of`
    is the attribute, or the function, that finds the value in what is written, if that is not a record. `rules` are
    further ones of its schema.
    """

    name: str = ""
    default: Any = REQUIRED
    meaning: str = ""
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    above: bool = False
    choices: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    kind: Any = None
    many: bool = False
    min_count: int = 0
    max_count: float = math.inf
    ordered: bool = False
    different: bool = False
    or_one: bool = False
    form: str = ""
    check_text: Callable[[str], object] | None = None
    remedy: str = ""
    key: str = ""
    null: Any = REQUIRED
    make: Callable[[Any], Any] | None = None
    text: Callable[[Any], Any] | None = None
    optional: bool = False
    when: Callable[[Mapping[str, Any]], bool] | None = None
    inline: bool = False
    of: str | Callable[[Any], Any] = ""
    rules: Schema = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        sample = self.default
        if isinstance(sample, list | tuple):
            object.__setattr__(self, "many", True)
            sample = sample[0] if sample else ""
        if self.kind is None:
            kind = Path if isinstance(sample, Path) else type(sample)
            object.__setattr__(self, "kind", str if sample is None or sample is REQUIRED else kind)

    @property
    def expected(self) -> str:  # type: ignore[override]  # of other shapes, it is always the same
        """A phrase for the values that the field accepts."""
        if self.form:
            return self.form
        if self.ordered:
            return f"[low, high], {self.phrase('both numbers')}"
        if self.many:
            counts = f"{self.min_count} to {self.max_count} " if math.isfinite(self.max_count) else ""
            counts = f"{self.min_count} " if self.min_count == self.max_count else counts
            alone = f"{self._names[0]}, or " if self.or_one else ""
            return f"{alone}a list of {counts}{self._names[1]}"
        if self.choices:
            return "one of " + ", ".join(self.choices)
        what = self._names[0] if isinstance(self.kind, ValueShape) else self.phrase(self._names[0])
        return " or ".join((*self.also, what))

    @property
    def several(self) -> str:  # type: ignore[override]  # of other shapes, it is always the same
        """What several of them are called."""
        return "lists" if self.many else self._names[1]

    @property
    def _names(self) -> tuple[str, str]:
        """What one value is, and what several are."""
        if isinstance(self.kind, ValueShape):
            return self.kind.expected, self.kind.several
        names = [NAMES[kind] for kind in (self.kind if isinstance(self.kind, tuple) else (self.kind,))]
        return " or ".join(single for single, _, _ in names), " or ".join(many for _, many, _ in names)

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

    def about(self, meaning: str) -> Field:
        """Return the same with a meaning."""
        return replace(self, meaning=meaning)

    @cached_property
    def one(self) -> Field:
        """The field of one value of a list."""
        alone = replace(self, many=False, ordered=False, or_one=False, default=REQUIRED)
        return replace(alone, make=None, form="", null=REQUIRED, rules={})

    def accepts(self, value: Any) -> bool:
        """Return true: `read` explains what it refuses."""
        return True

    def check(self, value: Any, where: str = "", error: type[CesError] = CesError) -> Any:
        """Return the value, a whole number as a float where that is the kind; raises `error` beginning with `where`."""
        with explaining(where or self.name, error):
            checked = self.read(value)
        return list(checked) if self.many and self.make is None else checked

    def parse(self, text: str) -> Any:
        """Return the value that a text on a command line stands for; raises CesError."""
        try:
            return self.read(self.kind(text))
        except (FieldError, ValueError) as reason:
            if self.check_text is not None:
                raise CesError(str(reason).removeprefix(": ")) from None
            raise CesError(f"found '{text}'; expected {self.expected}") from None

    def read(self, value: Any, base: Any = None, complete: bool = False) -> Any:
        """Return the value of a record for one in a file; raises FieldError. See `ValueShape` for the rest."""
        if self.null is not REQUIRED and value == self.null:
            return None
        if self.many:
            content = self._read_list(value, complete)
        elif isinstance(self.kind, ValueShape):
            if not self.kind.accepts(value):
                raise self.refusal(value)
            content = self.kind.read(value, base, complete)
        else:
            content = self._read_plain(value)
        try:
            return content if self.make is None else self.make(content)
        except (ValueError, CesError) as reason:
            raise FieldError(f": {reason}") from None

    def _read_list(self, value: Any, complete: bool) -> tuple[Any, ...]:
        good = isinstance(value, Sequence) and not isinstance(value, str)
        if not good and self.or_one:
            return (self.one.read(value),)
        if not good or not self.min_count <= len(value) <= self.max_count:
            raise self.refusal(value)
        item_field = self.one
        if (
            item_field.kind is float
            and all(type(v) is float and item_field.low <= v <= item_field.high for v in value)
            and not item_field.above
        ):
            items = tuple(value)  # at once, for long lists of numbers
        else:
            items = tuple(read_part(f"[{i}]", item_field, item, None, complete) for i, item in enumerate(value))
        if self.ordered and items[0] > items[-1]:
            raise self.refusal(value)
        if self.different and (twice := next((v for i, v in enumerate(items) if v in items[:i]), None)) is not None:
            raise FieldError(f": {quote(twice)} is given twice; keep one")
        return items

    def _read_plain(self, value: Any) -> Any:
        if isinstance(value, str) and value in self.also:
            return value
        if not self.takes(value):
            raise self.refusal(value)
        if self.check_text is not None:
            try:
                self.check_text(str(value))
            except ValueError as reason:
                raise FieldError(f": {reason}") from None
        return float(value) if self.kind is float else value

    def takes(self, value: Any) -> bool:
        """Return whether it accepts one plain value."""
        if self.choices:
            return value in self.choices
        if self.kind is object:
            return True
        if self.kind in (bool, int):
            good = type(value) is self.kind
        elif self.kind is float:
            good = isinstance(value, int | float) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST
        elif self.kind is Path:
            good = isinstance(value, str | Path)
        else:
            good = isinstance(value, self.kind) and not isinstance(value, bool)
        if not good or not isinstance(value, int | float) or self.kind is bool:
            return good
        return bool(value <= self.high and (self.low < value if self.above else self.low <= value))

    def refusal(self, value: Any) -> FieldError:
        """Return what is wrong with a value that is not `expected`."""
        return FieldError(f" is {quote(value)}; expected {self.expected}{self.advice}")

    @property
    def advice(self) -> str:
        """The remedy at the end of a message."""
        return f"; {self.remedy}" if self.remedy else ""

    def write(self, value: Any) -> Any:
        """Return the value as a file has it."""
        if value is None:
            return None if self.null is REQUIRED else self.null
        value = value if self.text is None else self.text(value)
        if not isinstance(self.kind, ValueShape):
            return list(value) if self.many else value
        return [self.kind.write(item) for item in value] if self.many else self.kind.write(value)

    @property
    def schema(self) -> Schema:
        """The JSON Schema (draft 7) of the value, with its default and meaning."""
        schema = self.bare_schema
        if self.default not in (REQUIRED, None, (), []) and not isinstance(self.kind, ValueShape):
            schema["default"] = list(self.default) if self.many else self.default
        return schema | ({"description": self.described} if self.meaning else {})

    @property
    def bare_schema(self) -> Schema:
        """The JSON Schema of the value alone, with its `rules`; one of them may be a reference to it elsewhere."""
        if "$ref" in self.rules:
            return self.rules
        schema = self._shape_schema()
        if self.null is None or self.also:
            others = [{"type": "null"}] if self.null is None else [{"const": word} for word in self.also]
            schema = {"anyOf": [*others, schema]}
        return schema | self.rules

    def _shape_schema(self) -> Schema:
        if self.many:
            items: Schema = {"type": "array", "items": self.one.bare_schema}
            items |= {"minItems": self.min_count} if self.min_count else {}
            items |= {"maxItems": self.max_count} if math.isfinite(self.max_count) else {}
            items |= {"uniqueItems": True} if self.different else {}
            return {"anyOf": [self.one.bare_schema, items]} if self.or_one else items
        if isinstance(self.kind, ValueShape):
            return self.kind.schema
        if self.choices:
            return {"enum": list(self.choices)}
        if self.kind is object:
            return {}
        kinds = self.kind if isinstance(self.kind, tuple) else (self.kind,)
        types = [NAMES[kind][2] for kind in kinds]
        schema: Schema = {"type": types[0] if len(types) == 1 else types}
        if math.isfinite(self.low):
            schema["exclusiveMinimum" if self.above else "minimum"] = self.low
        return schema | ({"maximum": self.high} if math.isfinite(self.high) else {})


def read_part(key: str, declared: Field, value: Any, base: Any = None, complete: bool = False) -> Any:
    """Return what `one` reads of the value under `key` of a whole; raises FieldError with its place there."""
    try:
        return declared.read(value, base, complete)
    except FieldError as error:
        raise error.inside(key) from None


def missing(key: str, declared: Field) -> FieldError:
    """Return what is wrong with a mapping that lacks a key."""
    return FieldError(f": key '{key}' is missing; expected {declared.expected}{declared.advice}")


def require_known_keys(
    values: Mapping[str, Any], keys: Collection[str], where: str, error: type[CesError] = CesError
) -> None:
    """Raise `error` at the first key of a mapping that is not `known`."""
    for key in values:
        if key not in keys:
            raise error(f"{where}: unknown key {quote(key)}{suggest(str(key), keys)}")
