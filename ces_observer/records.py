"""Records: frozen dataclasses whose fields, declared once, read, write and describe the mappings of a file.

`read_record` makes a record of a mapping, such as from YAML or JSON, `write_record` the mapping again, and
`record_schema` its JSON Schema. An annotation is bool, int, float, str, Path, another record, Any, `X | None` (null),
`tuple[X, ...]` (a list), `tuple[float, float]` (a range, [low, high]), or `Mapping[str, X]` (values by name). What it
does not say is declared by `quantity`, `choice`, `part` and the like; what no file has, by `in_files(None)`.

A record whose values must fit together has a method `checked`, which returns it, or raises CesError.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache, reduce
from itertools import chain
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from ces_observer.errors import CesError, suggest
from ces_observer.fields import REQUIRED, Field, FieldError, Schema, ValueShape, explaining, missing, read_part
from ces_observer.json_text import quote
from ces_observer.shapes import ByName, Either

T = TypeVar("T")
Of = str | Callable[[Any], Any]  # an attribute of what is written, or a function of it
FIELD = "field"  # key in the metadata of a dataclass field


def declare(made: Field) -> Any:
    """Declare a dataclass field by a Field; its name and kind are those in the class."""
    if made.default is REQUIRED:
        return field(metadata=in_files(made))
    default = tuple(made.default) if isinstance(made.default, list) else made.default
    return field(default=default, metadata=in_files(made))


def in_files(made: Field | None) -> Mapping[str, Any]:
    """Return the metadata of a dataclass field that is declared by `made`; with None, no file has it."""
    return {FIELD: made}


def part(**settings: Any) -> Any:
    """Declare a dataclass field of which the annotation says all, apart from `settings` of a Field."""
    return declare(Field(**settings))


def quantity(
    default: Any, unit: str, meaning: str, low: float = -math.inf, high: float = math.inf, above: bool = False
) -> Any:
    """Declare a dataclass field: a number in `unit` inside [low, high], or (low, high] with `above`."""
    return declare(Field(default=default, unit=unit, meaning=meaning, low=low, high=high, above=above))


def choice(default: Any, meaning: str, choices: tuple[str, ...], **settings: Any) -> Any:
    """Declare a dataclass field that is one of the words in `choices`."""
    return declare(Field(default=default, meaning=meaning, choices=choices, **settings))


def bounded(low: float, high: float, meaning: str = "", default: Any = REQUIRED, **settings: Any) -> Any:
    """Declare a dataclass field of a number, or of numbers, inside [low, high]."""
    return declare(Field(default=default, meaning=meaning, low=low, high=high, **settings))


def items(min_count: int, max_count: int, meaning: str = "", **settings: Any) -> Any:
    """Declare a dataclass field: a list of `min_count` to `max_count` of what its annotation says."""
    return declare(Field(meaning=meaning, min_count=min_count, max_count=max_count, **settings))


def read_record(
    cls: type[T], values: object, where: str, error: type[CesError], base: T | None = None, complete: bool = False
) -> T:
    """Return `cls(**values)` with every value checked against its field, records in it included.

    Keys that are missing have the values of `base`, if it is given, else their defaults; of a `complete` file, which a
    program wrote, none may be missing. `where` begins every message, such as `sine.yaml: stroke`. Raises `error`.
    """
    with explaining(where, error):
        record: T = Field(kind=Record(cls)).read(values, base, complete)
    return record


def write_record(record: Any, cls: type[Any] | None = None) -> dict[str, Any]:
    """Return the mapping that `read_record` reads as `record`, or as a `cls` whose fields say where its values are."""
    written: dict[str, Any] = Record(cls or type(record)).write(record)
    return written


def clip_numbers(record: T) -> T:
    """Return the record with its numbers, and those of records in it, within the ranges of their fields."""
    cls: Any = type(record)
    clipped: T = cls(**{f.name: _clip(getattr(record, f.name), record_fields(cls)[f.name]) for f in fields(cls)})
    return clipped


def _clip(value: Any, one: Field) -> Any:
    if isinstance(value, tuple):
        return tuple(_clip(item, one) for item in value)
    if is_dataclass(value):
        return clip_numbers(value)
    return min(max(value, one.low), one.high) if isinstance(value, float) else value


def read_document(record: Field, values: object, source: str, schema: str, remedy: str, error: type[CesError]) -> Any:
    """Return the record of a whole file of ours, complete and with its `schema` under that key; raises `error`."""
    if not isinstance(values, Mapping):
        raise error(f"{source} is {quote(values)}; expected an object with schema '{schema}'")
    kind = str(values.get("schema")).partition("/")[0]
    if kind.startswith("ces-") and kind != schema.partition("/")[0]:
        raise error(f"{source} is a file of another kind, {kind}; expected {schema.partition('/')[0]}")
    if values.get("schema") != schema:
        raise error(f"{source}: schema is {quote(values.get('schema'))}; expected '{schema}': {remedy}")
    content = {key: value for key, value in values.items() if key != "schema"}
    with explaining(source, error):
        return record.read(content, None, complete=True)


def document_schema(record: Field, name: str) -> Schema:
    """Return the JSON Schema of a whole file of ours, which names its schema."""
    schema = record.schema
    properties = {"schema": {"const": name}, **schema["properties"]}
    return schema | {"properties": properties, "required": ["schema", *schema["required"]]}


def record_schema(cls: type[Any], partial: bool = False) -> Schema:
    """Return the JSON Schema of a mapping that `read_record` reads; with `partial` (a `base`), no key is required."""
    return Record(cls, partial=partial).schema


def record_of(**keys: Field | tuple[Field, Of]) -> Field:
    """Return the field of a mapping with these keys, read as a dictionary; a pair says where a value is found too."""
    pairs = {key: value if isinstance(value, tuple) else (value, key) for key, value in keys.items()}
    return Field(kind=Record(own={key: replace(one, name=key, key=key, of=of) for key, (one, of) in pairs.items()}))


@cache
def record_fields(cls: Any) -> Mapping[str, Field]:
    """Return the fields of a dataclass by name, with the kinds of its annotations; a list of numbers is not empty."""
    hints, made_fields = get_type_hints(cls), {}
    for f in fields(cls):
        made = f.metadata.get(FIELD, Field())
        if made is None:
            continue
        default = f.default if f.default_factory is MISSING else f.default_factory()
        named = replace(made, name=f.name, key=made.key or f.name, default=REQUIRED if default is MISSING else default)
        made_fields[f.name] = named if made.make else replace(named, **_shape(hints[f.name], made))
    return made_fields


def _shape(hint: Any, made: Field) -> dict[str, Any]:
    """Return the attributes of a field that its annotation tells; a kind that is declared counts more."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        kinds = tuple(kind for kind in arguments if kind is not NoneType)
        null = {"null": None} if len(kinds) < len(arguments) and made.null is REQUIRED else {}
        return _shape(kinds[0], made) | null if len(kinds) == 1 else {"kind": _kind(kinds, made)} | null
    if hint == tuple[float, float]:
        return {"kind": float, "many": True, "ordered": True, "min_count": 2, "max_count": 2}
    if origin is tuple:
        inner = _shape(arguments[0], made)
        if "many" in inner or "null" in inner:
            return {"kind": Field(low=made.low, high=made.high, **inner), "many": True}
        numbers = inner["kind"] in (int, float) and not made.choices
        return {**inner, "many": True, "min_count": max(made.min_count, 1) if numbers else made.min_count}
    if origin is Mapping and arguments[1] is not Any:
        return {"kind": _kind(ByName(Field(low=made.low, high=made.high, **_shape(arguments[1], Field()))), made)}
    return {"kind": _kind(hint, made)}


def _kind(hint: Any, made: Field) -> Any:
    if isinstance(made.kind, ValueShape) or isinstance(hint, ValueShape):
        return made.kind if isinstance(made.kind, ValueShape) else hint
    if isinstance(hint, tuple):
        records: list[Any] = [kind for kind in hint if is_dataclass(kind)]
        kinds = tuple(kind for kind in hint if kind not in records)
        plain = replace(made, name="", default=REQUIRED, kind=kinds[0] if len(kinds) == 1 else kinds)
        return Either(plain, Record(records[0])) if records else hint
    if is_dataclass(hint):
        return Record(hint)
    return object if hint is Any else get_origin(hint) or hint


@dataclass(frozen=True, eq=False)
class Record(ValueShape):
    """The fields of a dataclass by their keys, or without one, the fields `own`, read as a dictionary.

    They are under one key if the dataclass has a `section`. A `partial` record needs no key, nor do the records in it:
    it has the defaults of the dataclass. Other keys of a `loose` one are left unread.
    """

    cls: Any = None
    own: Mapping[str, Field] | None = None
    partial: bool = False
    loose: bool = False

    @property
    def fields(self) -> Mapping[str, Field]:
        """The fields by their names."""
        return record_fields(self.cls) if self.own is None else self.own

    @property
    def expected(self) -> str:  # type: ignore[override]  # of other shapes, it is always the same
        """A phrase for what is read."""
        choices = (
            option.kind.expected for option in self.fields.values() if option.inline and isinstance(option.kind, OneOf)
        )
        return next(choices, super().expected)

    @property
    def section(self) -> str:
        """The key above those of the fields, if there is one."""
        return getattr(self.cls, "section", "")

    def keys(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys that it has in the mapping that it is in, given the values there; raises FieldError."""
        return (self.section,) if self.section else self._keys(values)

    def _keys(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        own = (own_field for own_field in self.fields.values() if own_field.when is None or own_field.when(values))
        return tuple(
            chain.from_iterable(
                own_field.kind.keys(values) if own_field.inline else (own_field.key,) for own_field in own
            )
        )

    def read(self, value: Any, base: Any = None, complete: bool = False) -> Any:
        """Return the record; raises FieldError at the first value that is wrong."""
        if not self.section:
            return self._read(value, base, complete)
        if self.section not in value:
            raise FieldError(f": key '{self.section}' is missing; expected {self.expected}")
        try:
            return self._read(value[self.section], base, complete)
        except FieldError as error:
            raise error.inside(self.section) from None

    def _read(self, value: Any, base: Any, complete: bool) -> Any:
        if not self.accepts(value):
            raise FieldError(f" is {quote(value)}; expected {self.expected}")
        base = self.cls() if self.partial and base is None else base
        keys = self._keys(value)
        for key in value:
            if key not in keys and not self.loose:
                raise FieldError(f": unknown key {quote(key)}{suggest(str(key), keys)}")
        own = {name: one for name, one in self.fields.items() if one.inline or one.key in keys}
        values = {name: _read_field(one, value, base, complete) for name, one in own.items()}
        if self.own is not None:
            return values
        try:
            made = self.cls(**{f.name: values[f.name] for f in fields(self.cls) if f.init and f.name in values})
            return made.checked() if hasattr(made, "checked") else made
        except CesError as reason:
            raise FieldError(f": {reason}") from None

    def write(self, value: Any) -> dict[str, Any]:
        """Return the values of the fields by their keys."""
        written = dict[str, Any]()
        for name, one in self.fields.items():
            item = one.of(value) if callable(one.of) else attrgetter(one.of or name)(value)
            if (one.when is not None and not one.when(vars(value))) or (one.optional and item == one.default):
                continue
            written |= one.write(item) if one.inline else {one.key: one.write(item)}
        return {self.section: written} if self.section else written

    @property
    def schema(self) -> Schema:
        """The JSON Schema."""
        properties, required, inline = dict[str, Schema](), list[str](), list[Schema]()
        for one in self.fields.values():
            if one.inline:
                inline.append(one.kind.schema)
                continue
            is_section = self.partial and isinstance(one.kind, Record) and not one.many
            properties[one.key] = replace(one.kind, partial=True).schema if is_section else one.schema
            required += [one.key] if one.default is REQUIRED and one.when is None and not self.partial else []
        schema: Schema = {"type": "object", "properties": properties, "additionalProperties": self.loose}
        schema |= {"required": required} if required else {}
        if self.own is None:
            about = (self.cls.__doc__ or "").split("\n\n", maxsplit=1)[0].split("; raises", maxsplit=1)[0]
            schema |= {"description": about.replace("\n    ", " ").strip(), **getattr(self.cls, "schema_rules", {})}
        schema = reduce(_join_schemas, sorted(inline, key=lambda one: "allOf" in one), schema)
        above: Schema = {"type": "object", "properties": {self.section: schema}, "required": [self.section]}
        return above if self.section else schema


def _read_field(declared: Field, values: Mapping[str, Any], base: Any, complete: bool) -> Any:
    """Return the value of a field in the mapping of its record; raises FieldError."""
    if declared.inline:
        return declared.read({key: values[key] for key in declared.kind.keys(values) if key in values}, None, complete)
    if declared.key in values:
        return read_part(declared.key, declared, values[declared.key], base and getattr(base, declared.name), complete)
    if base is not None:
        return getattr(base, declared.name)
    if declared.default is REQUIRED or (complete and not declared.optional):
        raise missing(declared.key, declared)
    return declared.default


def _join_schemas(own: Schema, inline: Schema) -> Schema:
    """Return the schema of a record with the keys of another one, or of one of several, beside its own."""
    if "allOf" in inline:
        rules = [{**rule, "then": _join_schemas(own, rule["then"])} for rule in inline["allOf"]]
        return {**inline, "allOf": rules}
    joined = {**own, "properties": {**inline["properties"], **own["properties"]}}
    required = [*inline.get("required", ()), *own.get("required", ())]
    about = {"description": inline["description"]} if "description" in inline else {}
    return joined | ({"required": required} if required else {}) | about


@dataclass(frozen=True, eq=False)
class OneOf(ValueShape):
    """One of several records: of the name under the key `tag`, or without a tag, the only one whose name is a key."""

    named: Mapping[str, Any] | Callable[[], Mapping[str, Any]]
    tag: str = "kind"

    @property
    def kinds(self) -> Mapping[str, Record]:
        """The records by their names; those of dataclasses need not be named as such."""
        named = self.named() if callable(self.named) else self.named
        return {name: kind if isinstance(kind, Record) else Record(kind) for name, kind in named.items()}

    @property
    def expected(self) -> str:  # type: ignore[override]  # of other shapes, it is the same for all
        """A phrase for what is read."""
        *names, last = self.kinds
        return f"a mapping with {self.tag}" if self.tag else f"a mapping with one of {', '.join(names)} and {last}"

    def _choose(self, values: Any) -> Record:
        given = [name for name in self.kinds if name in values]
        if not self.tag and len(given) != 1:
            raise FieldError(f" is {quote(values)}; expected {self.expected}")
        if self.tag and self.tag not in values:
            raise FieldError(f": key '{self.tag}' is missing; expected one of {', '.join(self.kinds)}")
        name = values[self.tag] if self.tag else given[0]
        if not isinstance(name, str) or name not in self.kinds:
            raise FieldError(f" is {quote(name)}; expected one of {', '.join(self.kinds)}", self.tag)
        return self.kinds[name]

    def keys(self, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the tag and the keys of the chosen record."""
        return tuple(dict.fromkeys((*filter(None, [self.tag]), *self._choose(values).keys(values))))

    def read(self, value: Any, base: Any = None, complete: bool = False) -> Any:
        """Return the chosen record; raises FieldError."""
        chosen = self._choose(value)
        if self.tag not in chosen.keys(value):
            value = {key: item for key, item in value.items() if key != self.tag}
        return chosen.read(value, None, complete)

    def write(self, value: Any) -> dict[str, Any]:
        """Return what the record writes, with its name under the tag."""
        name, record = next((name, one) for name, one in self.kinds.items() if type(value) is one.cls)
        written = record.write(value)
        return written if not self.tag or self.tag in written else {self.tag: name, **written}

    @property
    def schema(self) -> Schema:
        """The schema that applies that of the chosen record, so that an error names the key at fault."""
        if not self.tag:
            return {"type": "object", "anyOf": [one.schema for one in self.kinds.values()]}
        rules = list[Schema]()
        for name, one in self.kinds.items():
            branch, tagged = one.schema, {self.tag: {"const": name}}
            branch["properties"] = tagged | {k: v for k, v in branch["properties"].items() if k != self.tag}
            branch["required"] = list(dict.fromkeys((self.tag, *branch.get("required", ()))))
            rules.append({"if": {"properties": tagged, "required": [self.tag]}, "then": branch})
        names = {self.tag: {"enum": list(self.kinds)}}
        return {"type": "object", "properties": names, "required": [self.tag], "allOf": rules}


def walk_record(record: Any, prefix: str = "") -> Iterator[tuple[str, Any, Field]]:
    """Yield the path, value and field of every value in a record, such as `seal.coulomb_N`."""
    cls: Any = type(record)
    for name, declared in record_fields(cls).items():
        value = getattr(record, name)
        if is_dataclass(value):
            yield from walk_record(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value, declared
