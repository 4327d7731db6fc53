"""Builds frozen dataclasses from descriptions in YAML: a mapping goes in, a checked object or a RigError comes out.

A field made by `quantity` carries its unit, plausible range and meaning, so that one declaration checks a file,
explains an error and prints the table in the documentation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, field, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

from ces_identify.config_file import require_known_keys
from ces_rig.errors import RigError

T = TypeVar("T")
REQUIRED = object()


def quantity(
    default: Any, unit: str, what: str, low: float = -math.inf, high: float = math.inf, above: bool = False
) -> Any:
    """Declare a dataclass field: a number in `unit` inside [low, high], or (low, high] with `above`."""
    limits = {"unit": unit, "what": what, "low": low, "high": high, "above": above}
    return field(metadata=limits) if default is REQUIRED else field(default=default, metadata=limits)


def choice(default: str, what: str, options: tuple[str, ...]) -> Any:
    """Declare a dataclass field that is one of the words in `options`."""
    return field(default=default, metadata={"unit": "", "what": what, "options": options})


def build(cls: type[T], values: object, where: str) -> T:
    """Return `cls(**values)` with every value checked against its field, nested dataclasses included.

    `where` begins every message, such as `sine.yaml: stroke`. Raises RigError.
    """
    if not isinstance(values, Mapping):
        raise RigError(f"{where}: expected a mapping of keys to values, found {values!r}")
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    require_known_keys(values, known, where, RigError)
    for name, f in known.items():
        if name not in values and f.default is MISSING and f.default_factory is MISSING:
            raise RigError(f"{where}: '{name}' is missing; expected {describe_field(f)}")
    hints = get_type_hints(cls)
    return cls(**{key: _value(known[key], hints[key], value, f"{where}: {key}") for key, value in values.items()})


def fill_defaults(values: Any, default: Any) -> Any:
    """Return the values of the dataclass `default`, overridden by those of the nested mapping `values`."""
    if not isinstance(values, Mapping) or not is_dataclass(default) or isinstance(default, type):
        return values
    return {
        **asdict(default),
        **{key: fill_defaults(value, getattr(default, key, None)) for key, value in values.items()},
    }


def describe_field(f: Field[Any]) -> str:
    """Return a phrase for the values that the field `f` accepts."""
    meta = f.metadata
    if "options" in meta:
        return "one of " + ", ".join(meta["options"])
    if not meta or (not math.isfinite(meta["low"]) and not math.isfinite(meta["high"])):
        return f"a finite number in {meta['unit']}" if meta else "a value"
    lower = f"a number {'above' if meta['above'] else 'from'} {meta['low']:g}"
    upper = f" to {meta['high']:g}" if math.isfinite(meta["high"]) else ""
    return f"{lower}{upper} {meta['unit']}".rstrip()


def _value(f: Field[Any], hint: Any, value: object, where: str) -> Any:
    if is_dataclass(hint):
        return build(hint, value, where)  # type: ignore[arg-type]
    if "options" in f.metadata:
        if value not in f.metadata["options"]:
            raise RigError(f"{where} is {value!r}; expected {describe_field(f)}")
        return value
    if hint is bool or hint is str:
        if not isinstance(value, hint):
            raise RigError(f"{where} is {value!r}; expected {'true or false' if hint is bool else 'a word'}")
        return value
    if hint == tuple[str, ...]:
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
            raise RigError(f"{where} is {value!r}; expected a list of words")
        return tuple(value)
    if hint == tuple[float, ...]:
        if not isinstance(value, list | tuple) or not value:
            raise RigError(f"{where} is {value!r}; expected a list of numbers")
        return tuple(_number(f, item, where) for item in value)
    number = _number(f, value, where)
    if hint is int and not number.is_integer():
        raise RigError(f"{where} is {value!r}; expected a whole number")
    return int(number) if hint is int else number


def _number(f: Field[Any], value: object, where: str) -> float:
    try:  # YAML 1.1 reads 1e6 as a string, so strings of numbers are accepted
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    low, high = f.metadata.get("low", -math.inf), f.metadata.get("high", math.inf)
    inside = low < number <= high if f.metadata.get("above") else low <= number <= high
    if not math.isfinite(number) or not inside:
        raise RigError(f"{where} is {value!r}; expected {describe_field(f)}")
    return number
