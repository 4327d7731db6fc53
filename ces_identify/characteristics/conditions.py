"""Conditions: cycles of one current, amplitude and frequency, and their values by a source beside the measured ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.characteristics.cycles import Cycles, CycleValues, group_values
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rules import BenchRules
from ces_identify.limits import DynoLimits

Condition = tuple[I, dict[str, float]]  # the cycles (indices, rising), and the columns that describe them


@dataclass(frozen=True)
class SourceValues:
    """The values of one condition's cycles by one source, beside the measured ones; `key` holds the shared columns.

    `chosen` (n,) are the cycles that the rules read the force from.
    """

    key: dict[str, Any]
    cycles: Cycles
    values: CycleValues
    measured: CycleValues
    chosen: Mask
    rules: BenchRules

    @property
    def amplitude_m(self) -> float:
        """The mean amplitude."""
        return float(self.key["amplitude_m"])

    @property
    def frequency_Hz(self) -> float:
        """The mean frequency."""
        return float(self.key["frequency_Hz"])

    def target(self, speed_m_s: float) -> float:
        """Return the target speed that a speed [m/s] is near to, without sign; NaN if there is none."""
        near = (v for v in self.rules.speeds_m_s if abs(abs(speed_m_s) / v - 1.0) <= self.rules.speed_tolerance)
        return min(near, key=lambda v: abs(abs(speed_m_s) - v), default=np.nan)

    def forces(self, direction: str) -> tuple[F, F, F]:
        """Return speed, force and difference (c,) of the chosen cycles in one direction."""
        half, measured = self.values.halves[direction], self.measured.halves[direction]
        difference = self.difference(half.force, measured.force)
        return half.speed[self.chosen], half.force[self.chosen], difference[self.chosen]

    def difference(self, values: F, measured: F) -> F:
        """Return values minus measured ones; NaN for the measurement itself."""
        return values - measured if self.key["source"] != MEASURED else np.full_like(values, np.nan)


def find_conditions(cycles: Cycles, tolerance_A: float) -> list[Condition]:
    """Return the cycles of each current, amplitude and frequency, by current, then peak speed, with their columns."""
    amplitude = 0.5 * np.ptp(cycles.position, axis=1)
    frequency = 1.0 / (cycles.time_s[:, -1] - cycles.time_s[:, 0])
    centre = 0.5 * (cycles.position.max(axis=1) + cycles.position.min(axis=1))
    conditions: list[Condition] = []
    for level in group_values(cycles.current_A, tolerance_A):
        current = cycles.current_A[level]
        for group in _group_cycles(np.sort(level), amplitude, frequency, centre):
            columns = {
                "current_A": float(current.mean()),
                "current_width_A": float(np.ptp(current)),
                "amplitude_m": float(amplitude[group].mean()),
                "frequency_Hz": float(frequency[group].mean()),
            }
            conditions.append((group, columns))
    return sorted(conditions, key=lambda c: (c[1]["current_A"], c[1]["amplitude_m"] * c[1]["frequency_Hz"]))


def _group_cycles(indices: I, amplitude: F, frequency: F, centre: F) -> Iterator[I]:
    """Yield groups of cycles: each cycle joins the first group whose means it matches."""
    members: list[list[int]] = []
    means: list[F] = []
    for index in indices.tolist():
        values = np.array([np.log(amplitude[index]), np.log(frequency[index]), centre[index] / amplitude[index]])
        limits = (DynoLimits.SAME, DynoLimits.SAME, DynoLimits.SAME_CENTRE)
        match = next((k for k, mean in enumerate(means) if (np.abs(values - mean) <= limits).all()), None)
        if match is None:
            members.append([index])
            means.append(values)
        else:
            members[match].append(index)
            means[match] += (values - means[match]) / len(members[match])
    yield from (np.array(group, np.int64) for group in members)


def mean(values: F) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else np.nan


def with_sd(name: str, unit: str, values: F) -> dict[str, Any]:
    """Return the columns of a mean and its standard deviation between cycles, NaN for fewer than MIN_REPEATS."""
    finite = values[np.isfinite(values)]
    sd = float(finite.std(ddof=1)) if len(finite) >= DynoLimits.MIN_REPEATS else np.nan
    return {f"{name}_{unit}": mean(values), f"{name}_sd_{unit}": sd}
