"""Sensors of a live rig: noise, bias, quantisation and dropouts of the recorded rig, one reading at a time.

A reading is taken exactly at the tick, so its stamp is exact; the recorded rig's phases and stamp jitter do not apply.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.random import Generator

from ces_rig.experiment import STREAMS, Truth
from ces_rig.sensors import Sensor, Sensors
from ces_rig.withheld.sensing import SENSING

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
        self.position = LiveSensor(sensors.position, np.random.default_rng([seed, STREAMS["position"]]))
        self.current = LiveSensor(sensors.current, np.random.default_rng([seed, STREAMS["measured_current"]]))
        self.force = LiveSensor(sensors.force, np.random.default_rng([seed, STREAMS["force"]]))
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
