"""Lagged, scaled regressors for networks and fuzzy rules: inputs of each tick in, a vector of numbers out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ces_observer.json_text import JsonObject
from ces_observer.proof.intervals import Interval, add, down, product, up
from ces_observer.structures.structure import MAX_LAG, OperatingRange, Ranges, hold

SIGNALS = ("force", "speed", "current", "position")
COLUMNS = {"position": 0, "speed": 1, "current": 2}
MAX_REGRESSORS = 64
MAX_NUMBER = 1e9  # weights and means: far beyond any fit, far below overflow
MIN_SPREAD = 1e-9


@dataclass(frozen=True)
class Regressor:
    """A signal `lag` ticks ago as (value - mean) / spread; mean and spread in the signal's unit (m, m/s, A, N).

    A `force` is the model's own past output (lag >= 1).
    """

    signal: str
    lag: int
    mean: float
    spread: float

    def to_json(self) -> dict[str, Any]:
        """Return the contents of the model file."""
        return asdict(self)

    def interval(self, inputs: Ranges) -> Interval:
        """Return an interval that holds it for all inputs in their ranges, and past forces of zero."""
        low, high = inputs.get(self.signal, (0.0, 0.0))
        shifted = add((low, high), (-self.mean, -self.mean))
        return down(shifted[0] / self.spread), up(shifted[1] / self.spread)


def parse_regressor(node: JsonObject) -> Regressor:
    """Check one regressor of a model file; raises ModelError."""
    node.require_only_keys("signal", "lag", "mean", "spread")
    signal = node.choice("signal", SIGNALS)
    return Regressor(
        signal,
        node.integer("lag", 1 if signal == "force" else 0, MAX_LAG),
        node.number("mean", -MAX_NUMBER, MAX_NUMBER),
        node.number("spread", MIN_SPREAD, MAX_NUMBER),
    )


def parse_regressors(node: JsonObject) -> tuple[Regressor, ...]:
    """Check the list `regressors` of a model file; raises ModelError."""
    return tuple(parse_regressor(item) for item in node.items("regressors", 1, MAX_REGRESSORS))


def parse_number(node: JsonObject, key: str) -> float:
    """Return a weight from a model file; raises ModelError."""
    return node.number(key, -MAX_NUMBER, MAX_NUMBER)


def scale_from(node: JsonObject) -> float:
    """Return the scale of the output [N]; raises ModelError."""
    return node.number("scale_N", MIN_SPREAD, MAX_NUMBER)


def affine(constant: float, slopes: Sequence[float], at: Sequence[Interval]) -> Interval:
    """Return an interval that holds constant + slopes . x for every x in the box `at`."""
    total = (constant, constant)
    for slope, interval in zip(slopes, at, strict=True):
        total = add(total, product((slope, slope), interval))
    return total


class LaggedRun:
    """The past of a free run; `clamped`, `held`: the last tick's inputs, force were outside the envelope.

    Before the first tick, forces are zero and inputs equal the first ones, as in `ces_observer.structures.polynomial`.
    """

    def __init__(self, depth: int, within: OperatingRange) -> None:
        """Keep `depth` ticks."""
        self._depth = depth + 1
        self._bounds = (*within.inputs["position"], *within.inputs["speed"], *within.inputs["current"])
        self._limits = within.force_N
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._rows: list[tuple[float, float, float]] = []
        self._forces = [0.0] * self._depth
        self.clamped = self.held = False

    def store_inputs(self, position: float, speed: float, current: float) -> None:
        """Store the inputs [m, m/s, A] of a new tick."""
        x0, x1, v0, v1, c0, c1 = self._bounds
        self.clamped = not (x0 <= position <= x1 and v0 <= speed <= v1 and c0 <= current <= c1)
        row = (min(max(position, x0), x1), min(max(speed, v0), v1), min(max(current, c0), c1))
        if not self._rows:
            self._rows.extend([row] * self._depth)
        self._rows.insert(0, row)
        self._rows.pop()

    def values(self, regressors: Sequence[Regressor]) -> list[float]:
        """Return the scaled regressors of this tick, before its force is known."""
        rows, forces = self._rows, self._forces
        return [
            ((forces[r.lag - 1] if r.signal == "force" else rows[r.lag][COLUMNS[r.signal]]) - r.mean) / r.spread
            for r in regressors
        ]

    def store_force(self, force: float) -> float:
        """Hold this tick's force [N] in its envelope, store it and return it; infinity if it is not finite."""
        low, high = self._limits
        self.held = not low <= force <= high
        force = hold(force, low, high) if self.held else force
        self._forces.insert(0, force)
        self._forces.pop()
        return force
