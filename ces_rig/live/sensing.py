"""The commanded current in the valve's driver: clipped, held, and replaced by a safe current when commands stop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf, isfinite

import numpy as np
from numpy.random import Generator

from ces_rig.sensors import Sensor, Sensors, Truth, make_rng
from ces_rig.withheld.sensing import SENSING


class Command:
    """Holds the last command inside `limits_A`; after `timeout_s` without a command (0: never) the safe current."""

    def __init__(self, limits_A: tuple[float, float], safe_A: float, timeout_s: float) -> None:
        self._low, self._high = limits_A
        self.safe_A, self.timeout_s = safe_A, timeout_s
        self._value, self._since = 0.0, -inf
        self.refused = 0

    def set_current(self, current_A: float, time_s: float) -> None:
        """Accept a command at a time of the rig; a command that is not finite is refused and counted."""
        if isfinite(current_A):
            self._value, self._since = current_A, time_s
        else:
            self.refused += 1

    def is_fresh(self, time_s: float) -> bool:
        """Return whether a command is in force."""
        age = time_s - self._since
        return age < inf and (self.timeout_s == 0.0 or age <= self.timeout_s)

    def at(self, time_s: float) -> float:
        """Return the current [A] that the driver sets."""
        current = self._value if self.is_fresh(time_s) else self.safe_A
        return min(max(current, self._low), self._high)


BLOCK = 1024


class LiveSensor:
    """One sensor with its own stream of random numbers; `noise` scales its imperfections, 0 makes it ideal."""

    def __init__(self, sensor: Sensor, rng: Generator) -> None:
        self._sensor, self._rng = sensor, rng
        self._normals: Iterator[float] = iter(())
        self.noise, self.dropout = 1.0, sensor.dropout

    def read(self, true: float) -> float | None:
        """Return the reading, or None if it is lost."""
        if self.dropout > 0.0 and self._rng.random() < self.dropout:
            return None
        if self.noise == 0.0:
            return true
        sensor = self._sensor
        value = true + sensor.bias + self.noise * sensor.noise * self._normal()
        return value if sensor.quantum == 0.0 else sensor.quantum * round(value / sensor.quantum)

    def _normal(self) -> float:
        for value in self._normals:
            return value
        self._normals = iter(self._rng.standard_normal(BLOCK).tolist())
        return next(self._normals)


class LiveSensors:
    """Position, current and force, the current at its own rate if lower; withheld effects act before the noise."""

    def __init__(
        self, sensors: Sensors, seed: int, rate_Hz: float, effects: Sequence[tuple[str, Mapping[str, float]]] = ()
    ) -> None:
        self.position = LiveSensor(sensors.position, make_rng(seed, "position"))
        self.current = LiveSensor(sensors.current, make_rng(seed, "measured_current"))
        self.force = LiveSensor(sensors.force, make_rng(seed, "force"))
        self.commanded = sensors.current_source == "commanded"
        self.current_every = max(1, round(rate_Hz / sensors.current.rate_Hz))
        self._effects = tuple(effects)
        self._pair = Truth(*(np.zeros(2) for _ in range(6)))  # at the start, for drifts, and now

    def set_imperfections(self, noise: float, dropout: float) -> None:
        """Set the scale of all imperfections and the share of lost samples."""
        for sensor in (self.position, self.current, self.force):
            sensor.noise, sensor.dropout = noise, dropout

    def apply_effects(
        self, time_s: float, stroke_m: float, current_A: float, force_N: float
    ) -> tuple[float, float, float]:
        """Return stroke, current and force of noise-free sensors with the withheld effects."""
        if not self._effects:
            return stroke_m, current_A, force_N
        pair = self._pair
        pair.time_s[1], pair.stroke_m[1], pair.coil_A[1], pair.force_N[1] = time_s, stroke_m, current_A, force_N
        for name, numbers in self._effects:
            pair = SENSING[name](pair, numbers)
        return float(pair.stroke_m[1]), float(pair.coil_A[1]), float(pair.force_N[1])
