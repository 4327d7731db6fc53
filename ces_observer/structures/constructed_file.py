"""The list `constructed` of a model file: definitions in, checked constructed inputs by name out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.constructed_inputs import (
    BASE,
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
)

RESERVED = (*BASE, "force", "products", "constructed")
NAME = re.compile(r"(?!.*_(abs|p\d|lag\d))[a-z][a-z0-9_]{0,39}")
SETTINGS = {
    "stop": ("of", "half_width"),
    "play": ("of", "half_width"),
    "lag": ("of", "time_constant_s"),
    "frequency": ("time_constant_s", "range_Hz", "floor_m"),
    "hat": ("of", "low", "peak", "high"),
}
KINDS = tuple(SETTINGS)
MAX_CONSTRUCTED = 64
MAX_WIDTH = 1e6  # [m, m/s, A]
MIN_WIDTH = 1e-9  # so that no slope overflows
MIN_HZ, MAX_HZ = 1e-3, 1e5


def parse_constructed(nodes: Iterable[JsonObject]) -> dict[str, ConstructedInput]:
    """Check the list `constructed` of a model file, and return its inputs by name; raises ModelError."""
    known: dict[str, ConstructedInput] = {}
    for node in nodes:
        one = _parse_one(node, known)
        if one.name in known:
            raise ModelError(f"{node.where}: name '{one.name}' occurs twice; expected a name for each input")
        known[one.name] = one
    return known


def require_name(name: str, where: str) -> str:
    """Return `name`; raises ModelError if it cannot be the name of a constructed input."""
    if name in RESERVED or not NAME.fullmatch(name):
        raise ModelError(
            f"{where}: name {name[:60]!r}; expected up to 40 lower-case letters, digits and _, not a signal's name, "
            "and without the suffixes of powers and lags (_abs, _p2, _lag1)"
        )
    return name


def _parse_one(node: JsonObject, known: Mapping[str, ConstructedInput]) -> ConstructedInput:
    name, kind = require_name(node.text("name"), node.where), node.choice("kind", KINDS)
    node.require_only_keys("name", "kind", *SETTINGS[kind])
    if kind == "frequency":
        return _parse_frequency(node, name)
    if kind == "hat":
        smooth = [one.name for one in known.values() if not isinstance(one, TriangularMembership)]
        return _parse_membership(node, name, node.choice("of", (*BASE, *smooth)), known)
    if kind == "lag":
        return Lag(name, node.choice("of", BASE), node.number("time_constant_s", 1e-4, 1e4))
    return Hysteresis(name, kind, node.choice("of", BASE), node.number("half_width", MIN_WIDTH, MAX_WIDTH))


def _parse_frequency(node: JsonObject, name: str) -> Frequency:
    """Check the settings of a frequency estimate; raises ModelError."""
    low, high = node.range("range_Hz", MAX_HZ)
    if not MIN_HZ <= low < high:
        raise ModelError(f"{node.where}: range_Hz is [{low:g}, {high:g}]; expected {MIN_HZ:g} <= low < high")
    return Frequency(
        name, node.number("time_constant_s", 1e-4, 1e4), (low, high), node.number("floor_m", MIN_WIDTH, MAX_WIDTH)
    )


def _parse_membership(
    node: JsonObject, name: str, of: str, known: Mapping[str, ConstructedInput]
) -> TriangularMembership:
    low, high = (None if node.value.get(key) is None else node.number(key, -1e6, 1e6) for key in ("low", "high"))
    peak = node.number("peak", -1e6, 1e6)
    falls = low is None or low <= peak - MIN_WIDTH
    if not (falls and (high is None or high >= peak + MIN_WIDTH)) or low is high is None:
        raise ModelError(
            f"{node.where}: low {low}, peak {peak:g}, high {high}; expected low < peak < high, one not null"
        )
    return TriangularMembership(name, of, low, peak, high, known.get(of))
