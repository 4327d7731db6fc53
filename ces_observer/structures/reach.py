"""How far a model with physics inside may extrapolate: its curves go on straight beyond what was recorded.

Inputs outside the envelope are used as they are, and marked, up to `reach` times the envelope about its middle (for the
speed about zero); beyond, they are clamped. The proof covers all of them.
"""

from __future__ import annotations

from ces_observer.structures.structure import OperatingRange, Range, Ranges

MAX_REACH = 10.0
INPUTS = ("position", "speed", "current")


def widen(inputs: Ranges, reach: float) -> dict[str, Range]:
    """Return the ranges of the inputs `reach` times as wide."""
    low, high = inputs["speed"]
    return {
        "position": _about_middle(inputs["position"], reach),
        "speed": (min(low, reach * low), max(high, reach * high)),
        "current": _about_middle(inputs["current"], reach),
    }


def _about_middle(one: Range, reach: float) -> Range:
    middle, half = 0.5 * (one[0] + one[1]), 0.5 * reach * (one[1] - one[0])
    return min(one[0], middle - half), max(one[1], middle + half)


class InputLimiter:
    """Marks inputs outside the envelope and clamps those beyond its reach; `outside` is that of the last inputs."""

    def __init__(self, within: OperatingRange, reach: float) -> None:
        self._envelope = tuple(bound for name in INPUTS for bound in within.inputs[name])
        wide = widen(within.inputs, reach)
        self._limits = tuple(bound for name in INPUTS for bound in wide[name])
        self.outside = False

    def limit(self, position: float, speed: float, current: float) -> tuple[float, float, float]:
        """Return the inputs [m, m/s, A], clamped where they are beyond reach."""
        x0, x1, v0, v1, c0, c1 = self._envelope
        if x0 <= position <= x1 and v0 <= speed <= v1 and c0 <= current <= c1:
            self.outside = False
            return position, speed, current
        self.outside = True
        x0, x1, v0, v1, c0, c1 = self._limits
        return min(max(position, x0), x1), min(max(speed, v0), v1), min(max(current, c0), c1)
