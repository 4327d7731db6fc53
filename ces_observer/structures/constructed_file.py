"""The block `constructed` of a model file: definitions in, checked constructed inputs by name out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from ces_observer.checked import Checked
from ces_observer.errors import ModelError
from ces_observer.structures.constructed import BASE, Constructed, Frequency, Hat, Hysteresis, Lag

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
MOST_CONSTRUCTED = 64
MOST_WIDTH = 1e6  # [m, m/s, A]
LEAST_WIDTH = 1e-9  # so that no slope overflows
LEAST_HZ, MOST_HZ = 1e-3, 1e5


def constructed_from(nodes: Iterable[Checked]) -> dict[str, Constructed]:
    """Check the list `constructed` of a model file, and return its inputs by name; raises ModelError."""
    known: dict[str, Constructed] = {}
    for node in nodes:
        one = _one_from(node, known)
        if one.name in known:
            raise ModelError(f"{node.where}: name '{one.name}' is taken; expected a name for each constructed input")
        known[one.name] = one
    return known


def require_name(name: str, where: str) -> str:
    """Return `name`; raises ModelError if a constructed input cannot be called so."""
    if name in RESERVED or not NAME.fullmatch(name):
        raise ModelError(
            f"{where}: name {name[:60]!r}; expected up to 40 small letters, digits and _, not a signal's own name, and "
            "without what powers are named by (_abs, _p2, _lag1)"
        )
    return name


def _one_from(node: Checked, known: Mapping[str, Constructed]) -> Constructed:
    name, kind = require_name(node.text("name"), node.where), node.choice("kind", KINDS)
    node.only("name", "kind", *SETTINGS[kind])
    if kind == "frequency":
        return _frequency_from(node, name)
    if kind == "hat":
        smooth = [one.name for one in known.values() if not isinstance(one, Hat)]
        return _hat_from(node, name, node.choice("of", (*BASE, *smooth)), known)
    if kind == "lag":
        return Lag(name, node.choice("of", BASE), node.number("time_constant_s", 1e-4, 1e4))
    return Hysteresis(name, kind, node.choice("of", BASE), node.number("half_width", LEAST_WIDTH, MOST_WIDTH))


def _frequency_from(node: Checked, name: str) -> Frequency:
    """Check the settings of a frequency estimate; raises ModelError."""
    low, high = node.range("range_Hz", MOST_HZ)
    if not LEAST_HZ <= low < high:
        raise ModelError(f"{node.where}: range_Hz is [{low:g}, {high:g}]; expected {LEAST_HZ:g} <= low < high")
    return Frequency(
        name, node.number("time_constant_s", 1e-4, 1e4), (low, high), node.number("floor_m", LEAST_WIDTH, MOST_WIDTH)
    )


def _hat_from(node: Checked, name: str, of: str, known: Mapping[str, Constructed]) -> Hat:
    low, high = (None if node.value.get(key) is None else node.number(key, -1e6, 1e6) for key in ("low", "high"))
    peak = node.number("peak", -1e6, 1e6)
    falls = low is None or low <= peak - LEAST_WIDTH
    if not (falls and (high is None or high >= peak + LEAST_WIDTH)) or low is high is None:
        raise ModelError(
            f"{node.where}: low {low}, peak {peak:g}, high {high}; expected low < peak < high, one not null"
        )
    return Hat(name, of, low, peak, high, known.get(of))
