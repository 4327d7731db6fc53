"""The constructed inputs at work, tick by tick; ces_observer.structures.constructed_inputs tells what they are.

`ces_identify.polynomial.constructed_kernels` holds their twins over whole arrays, operation by operation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi, sqrt
from typing import Protocol

TWO_PI = 2.0 * pi


class ConstructedRun(Protocol):
    """A constructed input at work, tick by tick."""

    def reset(self) -> None:
        """Forget the past."""

    def update(self, values: Sequence[float]) -> float:
        """Return the value at this tick; `values` are position, speed, current and what was constructed before."""


class StopRun:
    """Clips the sum of the moves of one column of the values to +-half."""

    def __init__(self, column: int, half: float) -> None:
        self._column, self._half = column, half
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._stop = 0.0
        self._last: float | None = None

    def update(self, values: Sequence[float]) -> float:
        """Return the value at this tick."""
        value = values[self._column]
        half, last = self._half, self._last
        if last is not None:
            moved = self._stop + (value - last)
            self._stop = half if moved > half else -half if moved < -half else moved
        self._last = value
        return self._stop


class PlayRun:
    """Follows one column of the values at a distance of at most half."""

    def __init__(self, column: int, half: float) -> None:
        self._column, self._half = column, half
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._play: float | None = None

    def update(self, values: Sequence[float]) -> float:
        """Return the value at this tick."""
        value = values[self._column]
        low, high, play = value - self._half, value + self._half, self._play
        self._play = play = value if play is None else low if play < low else high if play > high else play
        return play


class LagRun:
    """One column of the values behind a first-order lag."""

    def __init__(self, column: int, gain: float) -> None:
        self._column, self._gain = column, gain
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._lagged: float | None = None

    def update(self, values: Sequence[float]) -> float:
        """Return the value at this tick."""
        value, lagged = values[self._column], self._lagged
        self._lagged = lagged = value if lagged is None else lagged + self._gain * (value - lagged)
        return lagged


class FrequencyRun:
    """Mean squares of speed and position about their means, as one frequency."""

    def __init__(self, gain: float, floor_m: float, range_Hz: tuple[float, float]) -> None:
        self._low, self._high = range_Hz
        self._floor, self._gain = floor_m * floor_m, gain
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._started = False
        self._x = self._v = self._xx = self._vv = 0.0

    def update(self, values: Sequence[float]) -> float:
        """Return the value at this tick."""
        x, v, gain = values[0], values[1], self._gain
        if not self._started:
            self._started, self._x, self._v = True, x, v
        self._x = mean_x = self._x + gain * (x - self._x)
        self._v = mean_v = self._v + gain * (v - self._v)
        x, v = x - mean_x, v - mean_v
        self._xx = xx = self._xx + gain * (x * x - self._xx)
        self._vv = vv = self._vv + gain * (v * v - self._vv)
        told = sqrt(vv / (xx + self._floor)) / TWO_PI
        return self._low if told < self._low else self._high if told > self._high else told


class MembershipRun:
    """A membership of one column of the values, which has no past."""

    def __init__(self, column: int, at: Callable[[float], float]) -> None:
        self._column, self._at = column, at

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, values: Sequence[float]) -> float:
        """Return the value at this tick."""
        return self._at(values[self._column])
