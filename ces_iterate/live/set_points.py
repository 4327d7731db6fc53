"""The set points of a run, and what may go wrong in it, without ROS: times and measured positions go in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_iterate.commands import Commands
from ces_iterate.errors import IterateError
from ces_iterate.rigs.kinds import RosRigSettings

F = NDArray[np.float64]

FOLLOWS_S = 0.15  # the measured stroke is compared with the set points of so many last seconds
GRACE_S = 0.3  # after the start, until the first positions are due


@dataclass(frozen=True)
class SetPoints:
    """Stroke [m] and current [A], each (n,), `rate_hz` a second."""

    stroke_m: F
    current_A: F
    rate_hz: float

    @staticmethod
    def of_run(commands: Commands, rate_hz: float) -> SetPoints:
        """Return the set points of an experiment."""
        stroke, current = commands.at(1.0 / rate_hz)
        return SetPoints(stroke, current, rate_hz)

    @staticmethod
    def of_move(from_m: float, to_m: float, duration_s: float, current_A: float, rate_hz: float) -> SetPoints:
        """Return a smooth move that begins and ends at rest."""
        u = np.linspace(0.0, 1.0, max(2, round(duration_s * rate_hz)))
        stroke = from_m + (to_m - from_m) * u**3 * (10.0 + u * (6.0 * u - 15.0))
        return SetPoints(stroke, np.full(len(u), current_A), rate_hz)

    def __iter__(self) -> Iterator[tuple[float, float]]:
        return iter(zip(self.stroke_m.tolist(), self.current_A.tolist(), strict=True))


class RunWatch:
    """Breaks a run off when positions stop coming or the stroke does not follow its set points."""

    def __init__(self, settings: RosRigSettings, name: str, begin_s: float) -> None:
        self._settings, self._name, self._begin_s = settings, name, begin_s
        self._recent: list[float] = []
        self._keep = max(1, round(FOLLOWS_S * settings.rate_hz))

    def check(self, time_s: float, set_point_m: float, newest: tuple[float, float] | None) -> None:
        """Take the set point of `time_s` and the newest position as (time, stroke); raises IterateError."""
        self._recent = [*self._recent[-self._keep :], set_point_m]
        heard_s = newest[0] if newest else self._begin_s
        silent = time_s - heard_s
        if silent > self._settings.silence_s and time_s - self._begin_s > GRACE_S:
            raise IterateError(f"{self._name}: no position for {silent:.2f} s; the run was broken off, check the rig")
        if newest is None:
            return
        low, high = min(self._recent), max(self._recent)
        distance = max(low - newest[1], newest[1] - high, 0.0)
        if distance > self._settings.deviation_m:
            raise IterateError(
                f"{self._name}: the stroke is {1e3 * distance:.1f} mm from its set points, rig: deviation_m allows "
                f"{1e3 * self._settings.deviation_m:g} mm; the run was broken off, check the rig and its zero"
            )
