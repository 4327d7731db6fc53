"""Parts of JSON Schemas (draft 7): from dataclasses with `quantity` fields and from tables of node parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import Any, get_type_hints

from ces_observer.nodes.parameter_table import ParameterSpec

Schema = dict[str, Any]
TEXT: Schema = {"type": "string"}
FLAG: Schema = {"type": "boolean"}
NUMBER: Schema = {"type": "number"}
TEXTS: Schema = {"type": "array", "items": TEXT}


def with_description(schema: Schema, text: str) -> Schema:
    """Return `schema` with a description, which editors show beside the key."""
    return {**schema, "description": text}


def mapping_of(properties: Mapping[str, Schema], required: Sequence[str] = (), about: str = "") -> Schema:
    """Return the schema of a mapping with these keys and no others."""
    schema: Schema = {"type": "object", "properties": dict(properties), "additionalProperties": False}
    schema |= {"required": list(required)} if required else {}
    return schema | ({"description": about} if about else {})


def one_of(values: Iterable[object]) -> Schema:
    """Return the schema of a choice."""
    return {"enum": list(values)}


def number_between(low: float, high: float, above: bool = False, whole: bool = False) -> Schema:
    """Return the schema of a number in [low, high], with `above` in (low, high]; infinite limits are left out."""
    schema: Schema = {"type": "integer" if whole else "number"}
    if math.isfinite(low):
        schema["exclusiveMinimum" if above else "minimum"] = low
    return schema | ({"maximum": high} if math.isfinite(high) else {})


def list_of(item: Schema, least: int = 0) -> Schema:
    """Return the schema of a list."""
    return {"type": "array", "items": item} | ({"minItems": least} if least else {})


def one_or_list_of(item: Schema) -> Schema:
    """Return the schema of a value, or of a list of such values without repetition."""
    return {"anyOf": [item, {**list_of(item, 1), "uniqueItems": True}]}


def of_dataclass(cls: type[Any], partial: bool = False) -> Schema:
    """Return the schema of a description that `ces_rig.descriptions.build` reads into `cls`.

    With `partial`, missing keys are filled in before (`fill_defaults`), so that none is required.
    """
    hints = get_type_hints(cls)
    properties = {f.name: _of_field(f, hints[f.name], partial) for f in fields(cls)}
    missing = [f.name for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING]
    return mapping_of(properties, () if partial else missing, _first_sentence(cls.__doc__ or ""))


def of_kinds(kinds: Mapping[str, type[Any]], more: type[Any] | None = None, default: str = "") -> Schema:
    """Return the schema of a description that begins with its `kind`; `more` has the keys that all kinds share.

    With `default`, a description without a kind is of that one.
    """
    return choose_by_kind(list(kinds), list_branches(kinds, more, default), default)


def list_branches(kinds: Mapping[str, type[Any]], more: type[Any] | None = None, default: str = "") -> list[Schema]:
    """Return the schema of each kind for `choose_by_kind`."""
    common = of_dataclass(more)["properties"] if more else {}
    branches = []
    for name, cls in kinds.items():
        own = of_dataclass(cls)
        properties = {"kind": {"const": name}, **own["properties"], **common}
        required = [*([] if name == default else ["kind"]), *own.get("required", ())]
        branches.append(mapping_of(properties, required, own["description"]))
    return branches


def choose_by_kind(kinds: Sequence[str], branches: Sequence[Schema], default: str = "") -> Schema:
    """Return a schema that applies the branch of a mapping's `kind`, so that an error names the key at fault."""
    kind = {"properties": {"kind": one_of(kinds)}, "type": "object"} | ({} if default else {"required": ["kind"]})
    rules = [
        {
            "if": {"properties": {"kind": {"const": name}}, **({} if name == default else {"required": ["kind"]})},
            "then": branch,
        }
        for name, branch in zip(kinds, branches, strict=True)
    ]
    return {**kind, "allOf": rules}


def of_parameters(table: Iterable[ParameterSpec]) -> dict[str, Schema]:
    """Return the schemas of a node's parameters, nested where a name has dots."""
    tree: dict[str, Any] = {}
    for spec in table:
        *groups, last = spec.name.split(".")
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = spec
    return _nest(tree)


def _nest(tree: Mapping[str, Any]) -> dict[str, Schema]:
    return {
        name: _of_parameter(value) if isinstance(value, ParameterSpec) else mapping_of(_nest(value))
        for name, value in tree.items()
    }


def _of_parameter(spec: ParameterSpec) -> Schema:
    low, high = spec.range or (-math.inf, math.inf)
    schema: Schema
    if isinstance(spec.default, bool):
        schema = FLAG
    elif isinstance(spec.default, int | float):
        schema = number_between(low, high, whole=isinstance(spec.default, int))
    elif isinstance(spec.default, str):
        schema = one_of(spec.one_of) if spec.one_of else TEXT
    else:
        first = spec.default[0] if spec.default else ""
        schema = list_of(
            TEXT if isinstance(first, str) else {"type": "integer" if isinstance(first, int) else "number"}
        )
    return with_description({**schema, "default": spec.default}, spec.meaning)


def _of_field(f: Field[Any], hint: Any, partial: bool) -> Schema:
    meta = f.metadata
    if is_dataclass(hint):
        return of_dataclass(hint, partial)  # type: ignore[arg-type]
    schema = _of_type(hint, meta)
    if f.default is not MISSING:
        schema["default"] = list(f.default) if isinstance(f.default, tuple) else f.default
    unit = f" [{meta['unit']}]" if meta.get("unit") else ""
    return with_description(schema, f"{meta['what']}{unit}") if meta.get("what") else schema


def _of_type(hint: Any, meta: Mapping[str, Any]) -> Schema:
    if "options" in meta:
        return one_of(meta["options"])
    if hint in (bool, str):
        return dict(FLAG if hint is bool else TEXT)
    if hint == tuple[str, ...]:
        return dict(TEXTS)
    limits = meta.get("low", -math.inf), meta.get("high", math.inf), bool(meta.get("above"))
    if hint == tuple[float, ...]:
        return list_of(number_between(*limits), 1)
    return number_between(*limits, whole=hint is int)


def _first_sentence(text: str) -> str:
    return text.split("\n\n", maxsplit=1)[0].split("; raises", maxsplit=1)[0].replace("\n    ", " ").strip()
