"""The rules by which a test bench reads a damper: which cycles, where in the stroke, from when a step counts, limits.

`ces characterise --rules FILE.yaml` reads them; a key that is not given keeps its default. The sentences say in the
tables by which rule their numbers are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_data.config_file import read_yaml_mapping
from ces_identify.limits import DynoLimits
from ces_observer.errors import CesError
from ces_observer.records import choice, part, quantity, read_record, walk_record

ALL_CYCLES, LAST_CYCLE = "all", "last"
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

    t63_ms: float | None = _at_most("ms", "63.2 % of the change of force")
    t90_ms: float | None = _at_most("ms", "90 % of the change of force")
    rise_ms: float | None = _at_most("ms", "from 10 % to 90 % of the change of force")
    settled_ms: float | None = _at_most("ms", "time to settle")
    overshoot: float | None = _at_most("1", "overshoot as a share of the change of force")
    hysteresis_N: float | None = _at_most("N", "magnetic hysteresis")
    range_N: float | None = _at_least("N", "range from soft to hard")
    ratio: float | None = _at_least("1", "ratio of hard to soft")


@dataclass(frozen=True, kw_only=True)
class BenchRules:
    """The rules of a bench."""

    cycles: str = choice(
        ALL_CYCLES, "the force is the mean of all full cycles, or the last one of each hold", (ALL_CYCLES, LAST_CYCLE)
    )
    read_at: str = choice(
        PEAK_SPEED,
        f"where a stroke is read: at {DynoLimits.PEAK_SHARE:.0%} of its peak speed or more, or about its centre",
        (PEAK_SPEED, CENTRE),
    )
    window: float = quantity(
        0.1, "1", "of the whole stroke, about its centre; 0: where it crosses the centre", 0.0, 1.0
    )
    value: str = choice(MEAN, "what of the window; noise raises a maximum", (MEAN, MAXIMUM))
    speeds_m_s: tuple[float, ...] = quantity(
        (), "m/s", "target speeds; none: all that were run", 0.0, 100.0, above=True
    )
    speed_tolerance: float = quantity(0.05, "1", "relative difference from a target speed", 0.0, 0.5, above=True)
    gas_force_N: float = quantity(0.0, "N", "added to every force, negative to take it off; raw_N is without it")
    force_filter_Hz: float | None = quantity(
        None, "Hz", "low-pass of every force, 2nd-order Butterworth forwards and backwards", 1.0, 1e5
    )
    step_start: float = quantity(0.1, "1", "share of the change of current from which the times count", 0.01, 0.9)
    settled_share: float = quantity(0.02, "1", "of the change of force: how near is settled", 1e-3, 0.2)
    settled_for_ms: float = quantity(
        10.0, "ms", "for how long it is near; as long it must stay beyond 63 or 90 %", 0.0, 50.0
    )
    limit: CharacteristicLimits = part(default=CharacteristicLimits(), meaning="limits to judge by")

    @property
    def force_sentence(self) -> str:
        """How the forces of cycles are read."""
        where = f"where the speed is at least {100 * DynoLimits.PEAK_SHARE:g} % of its peak"
        if self.read_at == CENTRE:
            where = f"within {100 * self.window:g} % of the stroke about its centre"
            where = where if self.window else "where the stroke crosses its centre"
        which = "all full cycles" if self.cycles == ALL_CYCLES else "the last full cycle of each hold"
        what = "Mean" if self.value == MEAN else "Largest"
        return f"{what} force of {which} {where}{self._corrections}."

    @property
    def step_sentence(self) -> str:
        """How steps of the current are read."""
        start = f"Times from {100 * self.step_start:g} % of the change of the current"
        near = f"settled: within {100 * self.settled_share:g} % of the change for {self.settled_for_ms:g} ms"
        return f"{start}; {near}{self._corrections}."

    @property
    def _corrections(self) -> str:
        gas = f"; gas force of {self.gas_force_N:+g} N added" if self.gas_force_N else ""
        return gas + (f"; force behind a low-pass of {self.force_filter_Hz:g} Hz" if self.force_filter_Hz else "")


def load_rules(rules: RulesInput) -> BenchRules:
    """Return the rules of a file or a mapping, the defaults for None; raises CesError naming file and key."""
    if rules is None or isinstance(rules, BenchRules):
        return rules or BenchRules()
    if isinstance(rules, Mapping):
        return read_record(BenchRules, rules, "rules", CesError)
    return read_record(BenchRules, read_yaml_mapping(Path(rules), WHAT), str(rules), CesError)


def list_rules(rules: BenchRules) -> Iterator[tuple[str, str, str, str]]:
    """Yield key, value, unit and meaning of every rule; a limit that is not given is empty."""
    for key, value, field in walk_record(rules):
        text = ", ".join(map(str, value)) if isinstance(value, tuple) else "" if value is None else str(value)
        yield key, text, field.unit, field.meaning
