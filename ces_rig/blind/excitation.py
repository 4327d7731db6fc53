"""Excitations of blind cases: a kind and a seed go in, stroke and current commands come out.

`rich` covers speeds, strokes and currents; `road` is a vehicle's stroke with a controller's current; with
`constant_current` the valve never moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ces_rig.drive.currents import Binary, ConstantLevel, Current, FilteredNoise, Prbs, StrokeFollowing
from ces_rig.drive.strokes import FrequencyModulated, NoiseStroke, RoadStroke, Shape, fade

Array = NDArray[np.float64]
Parts = tuple[tuple[Shape, ...], Current]

RICH, ROAD, CONSTANT = "rich", "road", "constant_current"
EXCITATIONS = (RICH, ROAD, CONSTANT)
REACH_M = (0.034, 0.046)  # [m] range of a case's largest stroke, below the bump stops of a sound damper
FADE_S = 0.4  # [s]
ACTUATOR_HZ = 30.0  # [Hz] bandwidth of the rig's actuator
GRID_S = 0.5e-3  # [s]


@dataclass(frozen=True)
class Commands:
    """The commands of one recording on a uniform grid; arrays (n,)."""

    time_s: Array
    stroke_m: Array
    command_A: Array

    def around_peak(self, seconds: float) -> Commands:
        """Return `seconds` of it around the largest stroke, or all if it is shorter."""
        count = min(round(seconds / GRID_S) + 1, len(self.time_s))
        first = min(max(int(np.argmax(np.abs(self.stroke_m))) - count // 2, 0), len(self.time_s) - count)
        part = slice(first, first + count)
        return Commands(self.time_s[:count], self.stroke_m[part], self.command_A[part])


@dataclass(frozen=True)
class Drive:
    """Stroke and current of a case; the largest stroke of every recording is `reach_m`.

    With equal peaks, an effect that appears only at large strokes appears in every recording.
    """

    shapes: tuple[Shape, ...]
    current: Current
    reach_m: float

    def commands(self, seconds: float, seed: int) -> Commands:
        """Return the commands of one recording; equal seeds give equal commands."""
        time = np.arange(round(seconds / GRID_S) + 1, dtype=np.float64) * GRID_S
        rng = np.random.default_rng([seed, 0])
        stroke = np.sum([shape.samples(time, rng) for shape in self.shapes], axis=0)
        stroke = sosfiltfilt(butter(4, ACTUATOR_HZ, fs=1.0 / GRID_S, output="sos"), stroke)
        stroke = stroke * fade(time, FADE_S)
        stroke *= self.reach_m / float(np.abs(stroke).max())
        return Commands(time, stroke, self.current.samples(time, stroke, np.random.default_rng([seed, 1])))


def draw_drive(kind: str, range_A: tuple[float, float], rng: Generator) -> Drive:
    """Return a drive of this kind with drawn settings and currents inside `range_A`."""
    shapes, current = DRIVE_KINDS[kind](*range_A, rng)
    return Drive(shapes, current, rng.uniform(*REACH_M))


def _draw_rich(low: float, high: float, rng: Generator) -> Parts:
    kinds: tuple[Current, ...] = (
        Binary(low, high, shortest_s=0.06, mean_s=rng.uniform(0.2, 0.5)),
        Prbs(low, high, hold_s=rng.uniform(0.08, 0.2)),
        FilteredNoise(low, high, cutoff_Hz=rng.uniform(2.0, 6.0)),
    )
    return _draw_two_noises(rng), kinds[int(rng.integers(len(kinds)))]


def _draw_road(low: float, high: float, rng: Generator) -> Parts:
    road = RoadStroke(road_class="CD"[int(rng.integers(2))], vehicle_m_s=rng.uniform(10.0, 22.0))
    if rng.random() < 0.5:
        return (road,), FilteredNoise(low, high, cutoff_Hz=rng.uniform(1.5, 5.0))
    return (road,), StrokeFollowing(low, high, stroke_m=rng.uniform(0.006, 0.016), lag_s=rng.uniform(0.005, 0.02))


def _draw_constant(low: float, high: float, rng: Generator) -> Parts:
    level = ConstantLevel(low + (high - low) * rng.uniform(0.1, 0.8))
    if rng.random() < 0.5:
        return _draw_two_noises(rng), level
    swept = FrequencyModulated(amplitude_m=rng.uniform(0.008, 0.014), low_Hz=1.0, high_Hz=rng.uniform(5.0, 9.0))
    slow = NoiseStroke(peak_to_peak_m=rng.uniform(0.020, 0.040), cutoff_Hz=1.5, order=4)
    return (swept, slow), level


def _draw_two_noises(rng: Generator) -> tuple[Shape, ...]:
    fast = NoiseStroke(peak_to_peak_m=rng.uniform(0.030, 0.050), cutoff_Hz=rng.uniform(8.0, 15.0))
    slow = NoiseStroke(peak_to_peak_m=rng.uniform(0.030, 0.050), cutoff_Hz=rng.uniform(1.0, 2.5), order=4)
    return fast, slow


DRIVE_KINDS: dict[str, Callable[[float, float, Generator], Parts]] = {
    RICH: _draw_rich,
    ROAD: _draw_road,
    CONSTANT: _draw_constant,
}
