"""From current to the valve's setting: dead time, remanence, characteristic and pilot lag; current in, 0 to 1 out.

    delayed(k) = current(k - delay), interpolated between ticks
    remanence  = mean of plays of half widths 1/3, 1 and 5/3 of `hysteresis_A` (Prandtl-Ishlinskii operator)
    target     = characteristic(remanence), rising from 0 to 1, constant beyond its ends
    setting(k) = setting(k-1) + T / (lag + T) (target - setting(k-1)), with one lag for rising and one for falling

Every stage is driven by the current alone and none amplifies a difference, so the setting stays within 0 to 1.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from typing import Any, Self

from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject
from ces_observer.structures.increasing_curves import (
    IncreasingCurve,
    Piece,
    check_slopes,
    interpolate,
    parse_nodes,
    pieces,
)
from ces_observer.structures.structure import MAX_LAG

PLAYS = (1.0 / 3.0, 1.0, 5.0 / 3.0)  # half widths relative to their mean
MAX_LAG_S = 1.0
KEYS = ("current_A", "setting", "delay_ticks", "hysteresis_A", "rise_s", "fall_s")


@dataclass(frozen=True)
class ValvePath:
    """The valve's characteristic (setting over current [A], from 0 to 1) and its dynamics."""

    characteristic: IncreasingCurve
    delay_ticks: float
    hysteresis_A: float
    rise_s: float
    fall_s: float

    @property
    def max_lag(self) -> int:
        """Longest lag of the current in ticks."""
        return int(self.delay_ticks) + 1

    def steady(self, current_A: float) -> float:
        """Return the setting at a constant current [A], in the middle of the magnetic loop."""
        return min(max(interpolate(self.characteristic.at, self.characteristic.values, current_A), 0.0), 1.0)

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        return {
            **self.characteristic.to_json("current_A", "setting"),
            "delay_ticks": self.delay_ticks,
            "hysteresis_A": self.hysteresis_A,
            "rise_s": self.rise_s,
            "fall_s": self.fall_s,
        }

    @classmethod
    def from_json(cls, node: JsonObject) -> Self:
        """Check it in a model file; raises ModelError."""
        node.require_only_keys(*KEYS)
        currents = parse_nodes(node, "current_A")
        settings = parse_nodes(node, "setting", len(currents))
        check_slopes(node.where, currents, settings)
        if settings[0] != 0.0 or settings[-1] != 1.0:
            raise ModelError(f"{node.where}: setting runs from {settings[0]:g} to {settings[-1]:g}; expected 0 to 1")
        return cls(
            IncreasingCurve(currents, settings),
            node.number("delay_ticks", 0.0, MAX_LAG - 1),
            node.number("hysteresis_A", 0.0, 1e3),
            node.number("rise_s", 0.0, MAX_LAG_S),
            node.number("fall_s", 0.0, MAX_LAG_S),
        )


class ValveRun:
    """The valve's past."""

    def __init__(self, path: ValvePath, interval_s: float) -> None:
        self._path = path
        whole = int(path.delay_ticks)
        self._share = path.delay_ticks - whole
        self._currents: deque[float] = deque(maxlen=whole + 2)  # the oldest first
        self._halves = tuple(path.hysteresis_A * play for play in PLAYS) if path.hysteresis_A > 0.0 else ()
        self._nodes, self._pieces = _between_0_and_1(path.characteristic)
        self._rise = interval_s / (path.rise_s + interval_s)
        self._fall = interval_s / (path.fall_s + interval_s)
        self.reset()

    def reset(self) -> None:
        """Forget the past: earlier currents equal the first one to come."""
        self._currents.clear()
        self._plays = 0.0, 0.0, 0.0
        self._setting = 0.0

    def tick(self, current: float) -> float:
        """Return the setting after this tick's current [A]."""
        currents = self._currents
        if not currents:
            currents.extend([current] * (currents.maxlen or 0))
            self._plays = current, current, current
            self._setting = self._path.steady(current)
        currents.append(current)
        newer = currents[1]
        remanent = newer + self._share * (currents[0] - newer)
        if self._halves:
            a, b, c = self._plays
            for_a, for_b, for_c = self._halves
            a = low if a < (low := remanent - for_a) else high if a > (high := remanent + for_a) else a
            b = low if b < (low := remanent - for_b) else high if b > (high := remanent + for_b) else b
            c = low if c < (low := remanent - for_c) else high if c > (high := remanent + for_c) else c
            self._plays = a, b, c
            remanent = (a + b + c) / 3.0
        at, value, slope = self._pieces[bisect_left(self._nodes, remanent)]
        setting = self._setting
        change = value + slope * (remanent - at) - setting
        self._setting = setting = setting + (self._rise if change > 0.0 else self._fall) * change
        return setting


def _between_0_and_1(curve: IncreasingCurve) -> tuple[tuple[float, ...], tuple[Piece, ...]]:
    """Return ends and pieces of a curve that goes on straight to 0 and 1, and stays there."""
    inner = pieces(curve.at, curve.values)
    (first, low, rising), (last, high, falling) = inner[0], inner[-1]
    first, last = first - low / rising, last + (1.0 - high) / falling
    return (first, *curve.at[1:-1], last), ((first, 0.0, 0.0), *inner, (last, 1.0, 0.0))
