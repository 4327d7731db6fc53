"""Constructed inputs in candidate rules: a block of definitions in, checked definitions by name out."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from ces_observer.errors import CesError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.constructed_file import parse_constructed, require_name
from ces_observer.structures.constructed_inputs import BASE, ConstructedInput, make_memberships

Constructions = Mapping[str, tuple[ConstructedInput, ...]]  # by their name in rules and products

MEMBERSHIPS = "hats"
AUTO, FIRST_GUESS_S = "auto", 0.01
RULE_KINDS = ("stop", "play", "lag", "frequency", MEMBERSHIPS)
MAX_MEMBERSHIPS = 20
MAX_PEAK, MIN_PEAK_DISTANCE = 1e6, 1e-6  # [m, m/s, A, Hz] of memberships
FREQUENCY = {"time_constant_s": 0.25, "range_Hz": [0.5, 20.0], "floor_m": 1e-4}  # defaults


def replace_auto(raw: object) -> tuple[object, tuple[str, ...]]:
    """Return the block `constructed` with a guess for each lag whose time constant is `auto`, and their names."""
    if not isinstance(raw, Mapping):
        return raw, ()
    names = [n for n, one in raw.items() if isinstance(one, Mapping) and one.get("kind") == "lag"]
    auto = tuple(str(n) for n in names if raw[n].get("time_constant_s") == AUTO)
    return {n: {**one, "time_constant_s": FIRST_GUESS_S} if str(n) in auto else one for n, one in raw.items()}, auto


def constructions_from(
    raw: object, where: str, known: Constructions | None = None
) -> dict[str, tuple[ConstructedInput, ...]]:
    """Check the block `constructed` of a rules file, and return it after those in `known`; raises CesError."""
    if not isinstance(raw, Mapping):
        raise CesError(f"{where}: expected names, each with kind and settings")
    constructed = dict(known or {})
    for name in sorted(raw, key=lambda key: isinstance(raw[key], Mapping) and raw[key].get("kind") == MEMBERSHIPS):
        constructed[str(name)] = _construct(str(name), JsonObject(raw[name], f"{where}: {name}"), constructed)
    names = [one.name for group in constructed.values() for one in group]
    if len(set(names)) < len(names):
        raise CesError(f"{where}: hats are named NAME_1, NAME_2 and so on; expected these names to be free")
    return constructed


def _construct(name: str, node: JsonObject, known: Constructions) -> tuple[ConstructedInput, ...]:
    kind = node.choice("kind", RULE_KINDS)
    if kind == MEMBERSHIPS:
        smooth = {one.name: one for group in known.values() for one in group if one.kind != "hat"}
        of = node.choice("of", (*BASE, *smooth))
        peaks = _read_peaks(node.value.get("at"), f"{node.where}: at")
        return make_memberships(require_name(name, node.where), of, peaks, smooth.get(of))
    settings = {**(FREQUENCY if kind == "frequency" else {}), **node.value, "name": name}
    return tuple(parse_constructed([JsonObject(settings, node.where)]).values())


def _read_peaks(raw: object, where: str) -> list[float]:
    """Return the ascending peaks of the memberships of a blend; raises CesError."""
    good = isinstance(raw, list) and all(isinstance(x, int | float) and abs(x) < MAX_PEAK for x in raw)
    peaks = [float(x) for x in raw] if isinstance(raw, list) and good else []
    if not 2 <= len(peaks) <= MAX_MEMBERSHIPS or any(b - a < MIN_PEAK_DISTANCE for a, b in pairwise(peaks)):
        raise CesError(
            f"{where}: {raw!r}; expected 2 to {MAX_MEMBERSHIPS} ascending numbers, the peaks of the sub-models"
        )
    return peaks
