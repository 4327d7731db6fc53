"""A JSON Schema checker of the keywords that the schema of `gap.json` uses; it refuses a schema that uses others."""

from __future__ import annotations

from typing import Any

from ces_gap.report.gap_json import gap_schema

TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "null": type(None),
}
SCHEMA = gap_schema()
SILENT = {"$schema", "title", "description"}


def faults(value: Any, schema: dict[str, Any], root: dict[str, Any], at: str = "$") -> list[str]:
    """Return what is wrong with `value`, each with its place; empty if it follows the schema."""
    out: list[str] = []
    for keyword, rule in schema.items():
        if keyword not in SILENT:
            out += RULES[keyword](value, rule, root, at, schema)
    return out


def _type(value: Any, rule: Any, root: Any, at: str, schema: Any) -> list[str]:
    for name in [rule] if isinstance(rule, str) else rule:
        if isinstance(value, TYPES[name]) and (name == "boolean" or not isinstance(value, bool)):
            return []
    return [f"{at}: {value!r} is not {rule}"]


def _any_of(value: Any, rule: Any, root: Any, at: str, schema: Any) -> list[str]:
    found = [faults(value, one, root, at) for one in rule]
    return [] if [] in found else min(found, key=len)


def _properties(value: Any, rule: Any, root: Any, at: str, schema: Any) -> list[str]:
    there = value.items() if isinstance(value, dict) else ()
    return [f for key, inner in there if key in rule for f in faults(inner, rule[key], root, f"{at}.{key}")]


def _additional(value: Any, rule: Any, root: Any, at: str, schema: Any) -> list[str]:
    others = [key for key in value if key not in schema.get("properties", {})] if isinstance(value, dict) else []
    if rule is False:
        return [f"{at}: {key} is not foreseen" for key in others]
    return [f for key in others for f in faults(value[key], rule, root, f"{at}.{key}")]


def _items(value: Any, rule: Any, root: Any, at: str, schema: Any) -> list[str]:
    there = value if isinstance(value, list) else []
    return [f for i, inner in enumerate(there) for f in faults(inner, rule, root, f"{at}[{i}]")]


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


RULES = {
    "type": _type,
    "anyOf": _any_of,
    "properties": _properties,
    "additionalProperties": _additional,
    "items": _items,
    "const": lambda v, r, _, at, s: [] if v == r else [f"{at}: {v!r} is not {r!r}"],
    "enum": lambda v, r, _, at, s: [] if v in r else [f"{at}: {v!r} is none of {r}"],
    "required": lambda v, r, _, at, s: [f"{at}: {k} is missing" for k in r if isinstance(v, dict) and k not in v],
    "minimum": lambda v, r, _, at, s: [f"{at}: {v} is below {r}"] if _number(v) and v < r else [],
    "maximum": lambda v, r, _, at, s: [f"{at}: {v} is above {r}"] if _number(v) and v > r else [],
    "minLength": lambda v, r, _, at, s: [f"{at}: too short"] if isinstance(v, str) and len(v) < r else [],
    "minItems": lambda v, r, _, at, s: [f"{at}: too few"] if isinstance(v, list) and len(v) < r else [],
    "maxItems": lambda v, r, _, at, s: [f"{at}: too many"] if isinstance(v, list) and len(v) > r else [],
}
