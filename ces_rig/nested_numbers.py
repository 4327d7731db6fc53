"""Reads, lists and replaces numbers inside nested frozen dataclasses by their path, such as `seal.coulomb_N`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import reduce
from typing import Any, TypeVar

from ces_rig.descriptions import build, fill_defaults

T = TypeVar("T")


def number_paths(whole: object) -> Iterator[str]:
    """Yield the paths of all numbers in `whole`."""
    for f in fields(whole):  # type: ignore[arg-type]
        inner = getattr(whole, f.name)
        if is_dataclass(inner):
            yield from (f"{f.name}.{path}" for path in number_paths(inner))
        else:
            yield f.name


def get_number(whole: object, path: str) -> float:
    """Return the number at `path`."""
    return float(reduce(getattr, path.split("."), whole))  # type: ignore[arg-type]


def replace_numbers(whole: T, numbers: Mapping[str, Any], where: str = "plant") -> T:
    """Return `whole` with the `numbers` at their paths; raises RigError for one outside its declared range."""
    nested: dict[str, Any] = {}
    for path, number in numbers.items():
        *sections, last = path.split(".")
        inner = nested
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = number
    return build(type(whole), fill_defaults(nested, whole), where)
