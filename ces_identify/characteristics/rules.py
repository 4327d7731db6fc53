"""The rules by which a test bench reads a damper: which cycles, where in the stroke, from when a step counts, limits.

`ces characterise --rules FILE.yaml` reads them; a key that is not given keeps its default. The sentences say in the
tables by which rule their numbers are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ces_data.config_file import read_yaml_mapping
from ces_data.reading import as_path
from ces_identify.limits import DynoLimits
from ces_observer.errors import CesError
from ces_observer.records import choice, part, quantity, read_record, walk_record

ALL_CYCLES, LAST_CYCLE = "all", "last"
BRANCHES = {"unknown": 0, "raised": 1, "lowered": -1}  # of a hold of the current, by the current before it
PEAK_SPEED, CENTRE = "peak_speed", "centre"
MEAN, MAXIMUM = "mean", "maximum"
WHAT = "rules of a bench; 'ces schema rules' lists the keys"
RulesInput = Any  # the path of a file, a mapping, BenchRules, or None


def _at_most(unit: str, meaning: str) -> Any:
    return quantity(None, unit, f"{meaning}, at most", 0.0, 1e6, above=True)


def _at_least(unit: str, meaning: str) -> Any:
    return quantity(None, unit, f"{meaning}, at least", 0.0, 1e6, above=True)


@dataclass(frozen=True, kw_only=True)
class CharacteristicLimits:
    """Limits that the tables are judged by; one that is not given is not judged."""

    t63_ms: float | None = _at_most("ms", "time to 63.2 %")
    t90_ms: float | None = _at_most("ms", "time to 90 %")
    rise_ms: float | None = _at_most("ms", "10 to 90 %")
    settled_ms: float | None = _at_most("ms", "time to settle")
    overshoot: float | None = _at_most("1", "share of the change")
    hysteresis_N: float | None = _at_most("N", "magnetic hysteresis")
    range_N: float | None = _at_least("N", "hard minus soft")
    ratio: float | None = _at_least("1", "hard over soft")


@dataclass(frozen=True, kw_only=True)
class BenchRules:
    """The rules of a bench."""

    cycles: str = choice(
        ALL_CYCLES, "full cycles that the force is read from: all, or the last of each hold", (ALL_CYCLES, LAST_CYCLE)
    )
    read_at: str = choice(
        PEAK_SPEED,
        f"near the peak speed ({100 * DynoLimits.PEAK_SHARE:g} % or more), or about the centre of the stroke",
        (PEAK_SPEED, CENTRE),
    )
    window: float = quantity(0.1, "1", "share of the whole stroke about its centre; 0: where it crosses it", 0.0, 1.0)
    value: str = choice(MEAN, "mean there, or at the instant of the largest mean", (MEAN, MAXIMUM))
    speeds_m_s: tuple[float, ...] = quantity((), "m/s", "target speeds; none: all", 0.0, 100.0, above=True)
    speed_tolerance: float = quantity(0.05, "1", "relative difference from a target speed", 0.0, 0.5, above=True)
    gas_force_N: float = quantity(0.0, "N", "added to every force (raw_N is without it)")
    first_hold: str = choice("unknown", "how the current reached the first hold of a recording", tuple(BRANCHES))
    step_start: float = quantity(0.1, "1", "share of the change of current from which times count", 0.01, 0.9)
    settled_share: float = quantity(0.02, "1", "of the change of force, within which it is settled", 1e-3, 0.2)
    settled_for_ms: float = quantity(10.0, "ms", "time that it stays settled, or beyond 63 and 90 %", 0.0, 50.0)
    limit: CharacteristicLimits = part(default=CharacteristicLimits(), meaning="limits to judge by")

    @property
    def force_sentence(self) -> str:
        """How the forces of cycles are read."""
        where = f"where the speed is at least {100 * DynoLimits.PEAK_SHARE:g} % of its peak"
        if self.read_at == CENTRE:
            where = f"within {100 * self.window:g} % of the stroke about its centre"
            where = where if self.window else "where the stroke crosses its centre"
        which = "all full cycles" if self.cycles == ALL_CYCLES else "the last full cycle of each hold"
        what = "Mean force" if self.value == MEAN else "Largest force (where it is largest in the mean cycle)"
        return f"{what} of {which} {where}{self._gas}."

    @property
    def step_sentence(self) -> str:
        """How steps of the current are read."""
        start = f"Times from {100 * self.step_start:g} % of the change of the current"
        near = f"settled: within {100 * self.settled_share:g} % of the change for {self.settled_for_ms:g} ms"
        return f"{start}; {near}{self._gas}."

    @property
    def _gas(self) -> str:
        return f"; gas force of {self.gas_force_N:+g} N added" if self.gas_force_N else ""


def load_rules(rules: RulesInput) -> BenchRules:
    """Return the rules of a file or a mapping, the defaults for None; raises CesError naming file and key."""
    if rules is None or isinstance(rules, BenchRules):
        return rules or BenchRules()
    if isinstance(rules, Mapping):
        return read_record(BenchRules, rules, "rules", CesError)
    return read_record(BenchRules, read_yaml_mapping(as_path(rules, "rules"), WHAT), str(rules), CesError)


def list_rules(rules: BenchRules) -> Iterator[tuple[str, str, str, str]]:
    """Yield key, value, unit and meaning of every rule; a limit that is not given is empty."""
    for key, value, field in walk_record(rules):
        text = ", ".join(map(str, value)) if isinstance(value, tuple) else "" if value is None else str(value)
        yield key, text, field.unit, field.meaning
