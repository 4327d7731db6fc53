"""How a case's plant is driven: the kind of stroke and current is the case's, each recording has its own seed.

`rich` sweeps speeds, strokes and currents; `road` is a vehicle's stroke with a controller's current; under
`constant_current` the valve never moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ces_rig.currents import Binary, ConstantCurrent, Current, FilteredNoise, Prbs, Reg1
from ces_rig.strokes import FrequencyModulated, Noise, Road, Shape, fade

Array = NDArray[np.float64]

RICH, ROAD, CONSTANT = "rich", "road", "constant_current"
EXCITATIONS = (RICH, ROAD, CONSTANT)
REACH_M = 0.046  # [m] largest stroke: short of the bump stops of a sound damper
FADE_S = 0.4  # [s]
ACTUATOR_HZ = 30.0  # [Hz] what the rig's actuator follows
GRID_S = 0.5e-3  # [s]


@dataclass(frozen=True)
class Commands:
    """What one recording's plant is driven with, on a uniform grid; arrays (n,)."""

    time_s: Array
    stroke_m: Array
    command_A: Array

    def opening(self, seconds: float) -> Commands:
        """Return what was commanded up to `seconds`."""
        part = slice(0, round(seconds / GRID_S) + 1)
        return Commands(self.time_s[part], self.stroke_m[part], self.command_A[part])


@dataclass(frozen=True)
class Drive:
    """What moves the plant and what feeds its valve."""

    shapes: tuple[Shape, ...]
    current: Current

    def commands(self, seconds: float, seed: int) -> Commands:
        """Return the commands of one recording; equal seeds give equal ones."""
        time = np.arange(round(seconds / GRID_S) + 1, dtype=np.float64) * GRID_S
        rng = np.random.default_rng([seed, 0])
        stroke = np.sum([shape.samples(time, rng) for shape in self.shapes], axis=0)
        stroke = sosfiltfilt(butter(4, ACTUATOR_HZ, fs=1.0 / GRID_S, output="sos"), stroke)
        stroke = stroke * min(1.0, REACH_M / float(np.abs(stroke).max())) * fade(time, FADE_S)
        return Commands(time, stroke, self.current.samples(time, stroke, np.random.default_rng([seed, 1])))


def draw_drive(kind: str, range_A: tuple[float, float], rng: Generator) -> Drive:
    """Return a drive of this kind, its settings drawn; its currents lie in `range_A`."""
    if kind == CONSTANT:
        return _constant(*range_A, rng)
    return _road(*range_A, rng) if kind == ROAD else Drive(_rich(rng), _moving_current(*range_A, rng))


def _rich(rng: Generator) -> tuple[Shape, ...]:
    fast = Noise(peak_to_peak_m=rng.uniform(0.030, 0.050), cutoff_Hz=rng.uniform(8.0, 15.0))
    slow = Noise(peak_to_peak_m=rng.uniform(0.030, 0.050), cutoff_Hz=rng.uniform(1.0, 2.5), order=4)
    return fast, slow


def _road(low: float, high: float, rng: Generator) -> Drive:
    road = Road(road_class="CD"[int(rng.integers(2))], vehicle_m_s=rng.uniform(10.0, 22.0))
    if rng.random() < 0.5:
        return Drive((road,), FilteredNoise(low, high, cutoff_Hz=rng.uniform(1.5, 5.0)))
    return Drive((road,), Reg1(low, high, stroke_m=rng.uniform(0.006, 0.016), lag_s=rng.uniform(0.005, 0.02)))


def _constant(low: float, high: float, rng: Generator) -> Drive:
    level = ConstantCurrent(low + (high - low) * rng.uniform(0.1, 0.8))
    if rng.random() < 0.5:
        return Drive(_rich(rng), level)
    swept = FrequencyModulated(amplitude_m=rng.uniform(0.008, 0.014), low_Hz=1.0, high_Hz=rng.uniform(5.0, 9.0))
    slow = Noise(peak_to_peak_m=rng.uniform(0.020, 0.040), cutoff_Hz=1.5, order=4)
    return Drive((swept, slow), level)


def _moving_current(low: float, high: float, rng: Generator) -> Current:
    kinds: tuple[Current, ...] = (
        Binary(low, high, shortest_s=0.06, mean_s=rng.uniform(0.2, 0.5)),
        Prbs(low, high, hold_s=rng.uniform(0.08, 0.2)),
        FilteredNoise(low, high, cutoff_Hz=rng.uniform(2.0, 6.0)),
    )
    return kinds[int(rng.integers(len(kinds)))]
