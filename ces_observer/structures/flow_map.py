"""A valve's map: one increasing curve for each of a few settings, blended linearly between neighbours.

The curves share their abscissa (a speed or a flow [m/s]) and give a force [N]; settings are spaced evenly from 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.increasing_curves import MAX_VALUE, IncreasingCurve, check_slopes, interpolate, parse_nodes

MAX_CURVES = 16


@dataclass(frozen=True)
class FlowMap:
    """Forces [N] over `at` [m/s]: `rows[k]` at the setting k / (rows - 1), each rising strictly."""

    at: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]

    def pick(self, setting: float) -> tuple[int, float]:
        """Return the row below a setting from 0 to 1, and the share of the next row."""
        place = setting * (len(self.rows) - 1)
        row = min(int(place), len(self.rows) - 2)
        return row, place - row

    def blend(self, setting: float) -> tuple[float, ...]:
        """Return the curve's values at a setting from 0 to 1."""
        row, share = self.pick(setting)
        return tuple(a + share * (b - a) for a, b in zip(self.rows[row], self.rows[row + 1], strict=True))

    def force(self, at: float, setting: float) -> float:
        """Return the force [N] at an abscissa [m/s] and a setting."""
        return interpolate(self.at, self.blend(setting), at)

    def max_force(self, at: float) -> float:
        """Return a bound on |force| [N] at abscissas [m/s] up to `at` in either direction, for every setting."""
        return max(abs(interpolate(self.at, row, x)) for row in self.rows for x in (-at, at))

    @property
    def inverses(self) -> tuple[IncreasingCurve, ...]:
        """The abscissa over the force at each row; at a setting between two rows it lies between theirs."""
        return tuple(IncreasingCurve(row, self.at) for row in self.rows)

    def to_json(self, at: str) -> dict[str, Any]:
        """Return the contents of the model file; `at` names the abscissa."""
        return {at: list(self.at), "force_N": [list(row) for row in self.rows]}

    @classmethod
    def from_json(cls, node: JsonObject, at: str) -> Self:
        """Check it in a model file; raises ModelError."""
        node.require_only_keys(at, "force_N")
        places = parse_nodes(node, at)
        rows = node.value.get("force_N")
        if not isinstance(rows, list) or not 2 <= len(rows) <= MAX_CURVES:
            raise ModelError(f"{node.where}: force_N has no 2 to {MAX_CURVES} lists; expected one for each setting")
        parsed = [parse_nodes(JsonObject({"force_N": row}, node.where), "force_N", len(places)) for row in rows]
        for row in parsed:
            check_slopes(node.where, places, row)
        return cls(places, tuple(parsed))


def parse_growth(node: JsonObject, key: str) -> float:
    """Check a number from 0 on in a model file; raises ModelError."""
    return node.number(key, 0.0, MAX_VALUE)
