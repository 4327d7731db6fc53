"""Groups of what was recorded alike (levels of current, conditions), and the rows of the tables about cycles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_data.arrays import F, I
from ces_identify.characteristics.cycles import (
    COMPRESSION,
    DIRECTIONS,
    HALF,
    MIN_CYCLES,
    REBOUND,
    SHARES,
    Cycles,
    CycleValues,
    evaluate_cycles,
)
from ces_identify.characteristics.motion import MEASURED, Stretch
from ces_identify.characteristics.rows import ContinuousForce, CycleWork, LoopPoint, PeakForce
from ces_identify.numerics.correlation import noise_rms

CURRENT_SHARE = 0.03  # of the largest current: less is the same current
CURRENT_NOISE = 8.0  # times the noise of the measured current: less is the same current
SAME_SIZE = 0.03  # relative difference of amplitude and of frequency within a condition
SAME_CENTRE = 0.2  # difference of the centre of the stroke within a condition, of the amplitude
FEW = f"fewer than {MIN_CYCLES} cycles: no spread"
NOTHING_DISSIPATED = "the loop dissipates nothing: check the sign of force or position, or the delay between them"
NO_RATIO = "one direction does not resist: no ratio (offset of the force?)"

Condition = tuple[I, dict[str, float]]  # the cycles (indices, rising), and the columns that describe them


@dataclass(frozen=True)
class SourceValues:
    """The values of one condition's cycles by one source, beside the measured ones; `key` holds the shared columns."""

    key: dict[str, Any]
    cycles: Cycles
    values: CycleValues
    measured: CycleValues

    def difference(self, values: F, measured: F) -> F:
        """Return values minus measured ones; NaN for the measurement itself."""
        return values - measured if self.key["source"] != MEASURED else np.full_like(values, np.nan)


def cycle_tables(cycles: Cycles, tolerance_A: float, sources: Sequence[str]) -> dict[str, tuple[Any, ...]]:
    """Return the tables about used cycles; those that need a spread leave out conditions with too few cycles."""
    tables: dict[str, list[Any]] = {name: [] for name in ROWS_OF}
    for indices, columns in find_conditions(cycles, tolerance_A):
        chosen = cycles.select(indices)
        measured = evaluate_cycles(chosen, MEASURED)
        for source in sources:
            values = measured if source == MEASURED else evaluate_cycles(chosen, source)
            count = int(np.isfinite(values.work_J).sum())
            one = SourceValues({"source": source, "cycles": count, **columns}, chosen, values, measured)
            for name, make_rows in ROWS_OF.items():
                if count >= (1 if name == "peak_velocity" else MIN_CYCLES):
                    tables[name] += make_rows(one)
    return {name: tuple(rows) for name, rows in tables.items()}


def current_tolerance(stretches: Sequence[Stretch]) -> float:
    """Return by how much [A] currents may differ and still count as the same."""
    largest, noise = 0.0, 0.0
    for current in (s.current[np.isfinite(s.current)] for s in stretches):
        if len(current):
            largest = max(largest, float(np.percentile(np.abs(current), 99.0)))
        changes = current[np.diff(current, prepend=np.nan) != 0.0]  # held samples would hide the noise
        noise = max(noise, noise_rms(changes if len(changes) > 0.1 * len(current) else current))
    return max(CURRENT_SHARE * largest, CURRENT_NOISE * noise, 1e-9)


def group_values(values: F, tolerance: float) -> list[I]:
    """Return the indices of each group of values (n,) that are close together, in rising order.

    Groups are separated by gaps of at least half the `tolerance`; one wider than twice the tolerance is cut into pieces
    one tolerance wide.
    """
    if not len(values):
        return []
    order = np.argsort(values, kind="stable")
    groups: list[I] = []
    for group in np.split(order, np.flatnonzero(np.diff(values[order]) > 0.5 * tolerance) + 1):
        above = values[group] - values[group[0]]
        cuts = np.flatnonzero(np.diff(np.floor(above / tolerance))) + 1
        groups += np.split(group, cuts) if above[-1] > 2.0 * tolerance else [group]
    return groups


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
        limits = (SAME_SIZE, SAME_SIZE, SAME_CENTRE)
        match = next((k for k, mean in enumerate(means) if (np.abs(values - mean) <= limits).all()), None)
        if match is None:
            members.append([index])
            means.append(values)
        else:
            members[match].append(index)
            means[match] += (values - means[match]) / len(members[match])
    yield from (np.array(group, np.int64) for group in members)


def peak_rows(one: SourceValues) -> Iterator[PeakForce]:
    """Yield the peak velocity pick-up in both directions."""
    for direction in DIRECTIONS:
        half, measured = one.values.halves[direction], one.measured.halves[direction]
        yield PeakForce(
            **one.key,
            direction=direction,
            speed_m_s=mean(half.peak_speed),
            **_with_sd("force", "N", half.peak_force),
            **_with_sd("difference", "N", one.difference(half.peak_force, measured.peak_force)),
            note=FEW if one.key["cycles"] < MIN_CYCLES else "",
        )


def continuous_rows(one: SourceValues) -> Iterator[ContinuousForce]:
    """Yield force and hysteresis at shares of the peak speed in both directions."""
    for direction in DIRECTIONS:
        half, measured = one.values.halves[direction], one.measured.halves[direction]
        difference, force, width = one.difference(half.mean, measured.mean), half.mean, half.width
        speed = mean(half.peak_speed)
        for k, share in enumerate(SHARES):
            yield ContinuousForce(
                **one.key,
                direction=direction,
                speed_m_s=float(share) * speed,
                accelerating_N=mean(half.accelerating[:, k]),
                decelerating_N=mean(half.decelerating[:, k]),
                **_with_sd("force", "N", force[:, k]),
                **_with_sd("width", "N", width[:, k]),
                difference_N=mean(difference[:, k]),
            )


def loop_rows(one: SourceValues) -> Iterator[LoopPoint]:
    """Yield the mean loop, from full rebound over full compression back."""
    for k in range(2 * HALF + 1):
        yield LoopPoint(
            **one.key,
            phase=k / (2 * HALF),
            position_m=mean(one.cycles.position[:, k]),
            speed_m_s=mean(one.cycles.speed[:, k]),
            **_with_sd("force", "N", one.cycles.forces[one.key["source"]][:, k]),
        )


def work_rows(one: SourceValues) -> Iterator[CycleWork]:
    """Yield work, equivalent damping and the forces at zero speed."""
    values = one.values
    compression, rebound = (mean(values.halves[d].peak_force) for d in (COMPRESSION, REBOUND))
    dissipates = mean(values.work_J) > 0.0
    damped = dissipates and compression > 0.0 > rebound
    yield CycleWork(
        **one.key,
        **_with_sd("work", "J", values.work_J),
        power_W=mean(values.power_W),
        **(_with_sd("damping", "Ns_m", values.damping_Ns_m) if dissipates else {}),
        **_with_sd("mid_force", "N", 0.5 * (values.top_N + values.bottom_N)),
        **_with_sd("zero_width", "N", values.top_N - values.bottom_N),
        zero_width_per_ms_N=mean(values.width_per_skew_N),
        rebound_ratio=-rebound / compression if damped else np.nan,
        **_with_sd("difference", "J", one.difference(values.work_J, one.measured.work_J)),
        note="" if damped else NO_RATIO if dissipates else NOTHING_DISSIPATED,
    )


ROWS_OF: dict[str, Callable[[SourceValues], Iterator[Any]]] = {
    "peak_velocity": peak_rows,
    "continuous": continuous_rows,
    "loops": loop_rows,
    "work": work_rows,
}


def mean(values: F) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def _with_sd(name: str, unit: str, values: F) -> dict[str, Any]:
    """Return the columns of a mean and its standard deviation between cycles, NaN for fewer than MIN_CYCLES."""
    known = values[np.isfinite(values)]
    sd = float(known.std(ddof=1)) if len(known) >= MIN_CYCLES else np.nan
    return {f"{name}_{unit}": mean(values), f"{name}_sd_{unit}": sd}
