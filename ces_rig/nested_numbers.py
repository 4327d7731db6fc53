"""Reads and replaces numbers inside nested frozen dataclasses by their path, such as `seal.coulomb_N`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from typing import Any, TypeVar

from ces_observer.fields import read_record
from ces_rig.errors import RigError

T = TypeVar("T")


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
    return read_record(type(whole), nested, where, RigError, whole)
