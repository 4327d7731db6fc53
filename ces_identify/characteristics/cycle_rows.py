"""Groups of what was recorded alike (levels of current, conditions), and the rows of the tables about cycles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_data.arrays import F, I
from ces_identify.characteristics.cycles import (
    COMPRESSION,
    DIRECTIONS,
    HALF,
    REBOUND,
    SHARES,
    Cycles,
    CycleValues,
    KneeFit,
    find_knee,
)
from ces_identify.characteristics.motion import MEASURED, Stretch, noise_rms
from ces_identify.characteristics.rows import ContinuousForce, CycleWork, Knee, LoopPoint, PeakForce

CURRENT_SHARE = 0.03  # of the largest current: less is the same current
CURRENT_NOISE = 8.0  # times the noise of the measured current: less is the same current
SAME_SIZE = 0.03  # relative difference of amplitude and of frequency within a condition
SAME_CENTRE = 0.2  # difference of the centre of the stroke within a condition, of the amplitude
MIN_CYCLES = 3  # for a spread, a loop, work, branches and a knee
FEW = f"fewer than {MIN_CYCLES} cycles: no spread"


@dataclass(frozen=True)
class Condition:
    """The cycles (indices, shape (n,)) of one current, amplitude and frequency; values are means over the cycles.

    `current_width_A` is the difference between the largest and the smallest mean current of the level's cycles.
    """

    cycles: I
    current_A: float
    current_width_A: float
    amplitude_m: float
    frequency_Hz: float


def current_tolerance(stretches: Sequence[Stretch]) -> float:
    """Return by how much [A] currents may differ and still count as the same."""
    known = [s.current[np.isfinite(s.current)] for s in stretches]
    largest = max((float(np.percentile(np.abs(c), 99.0)) for c in known if len(c)), default=0.0)
    noise = max((noise_rms(_find_changes(c)) for c in known), default=0.0)
    return max(CURRENT_SHARE * largest, CURRENT_NOISE * noise, 1e-9)


def group_values(values: F, tolerance: float) -> list[I]:
    """Return the indices of each group of values (n,) that are close together, in rising order.

    Groups are separated by gaps of at least half the `tolerance`; one wider than twice the tolerance is cut.
    """
    if not len(values):
        return []
    order = np.argsort(values, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(values[order]) > 0.5 * tolerance) + 1)
    return [piece for group in groups for piece in _cut(values, group, tolerance)]


def find_conditions(cycles: Cycles, tolerance_A: float) -> list[Condition]:
    """Return the conditions of used cycles, by current, then by peak speed."""
    amplitude = 0.5 * np.ptp(cycles.position, axis=1)
    frequency = 1.0 / (cycles.time_s[:, -1] - cycles.time_s[:, 0])
    centre = 0.5 * (cycles.position.max(axis=1) + cycles.position.min(axis=1))
    conditions = []
    for level in group_values(cycles.current_A, tolerance_A):
        current = cycles.current_A[level]
        for group in _group_cycles(np.sort(level), amplitude, frequency, centre):
            means = (float(amplitude[group].mean()), float(frequency[group].mean()))
            conditions.append(Condition(group, float(current.mean()), float(np.ptp(current)), *means))
    return sorted(conditions, key=lambda c: (c.current_A, c.amplitude_m * c.frequency_Hz))


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


def _cut(values: F, group: I, tolerance: float) -> Iterator[I]:
    """Yield a sorted group whole, or in pieces one tolerance wide if it is too wide."""
    if values[group[-1]] - values[group[0]] <= 2.0 * tolerance:
        yield group
        return
    piece = np.floor((values[group] - values[group[0]]) / tolerance).astype(np.int64)
    yield from np.split(group, np.flatnonzero(np.diff(piece)) + 1)


def _find_changes(current: F) -> F:
    """Return the current without repetitions of held samples, which would hide its noise."""
    keep = np.ones(len(current), np.bool_)
    keep[1:] = np.diff(current) != 0.0
    return current[keep] if keep.sum() > 0.1 * len(current) else current


@dataclass(frozen=True)
class SourceValues:
    """The values of the cycles of one condition by one source, beside the measured ones."""

    source: str
    condition: Condition
    cycles: Cycles
    values: CycleValues
    measured: CycleValues

    @property
    def key(self) -> dict[str, Any]:
        """The columns that all tables about cycles share."""
        c = self.condition
        count = int(np.isfinite(self.values.work_J).sum())
        means = {name: getattr(c, name) for name in ("current_A", "current_width_A", "amplitude_m", "frequency_Hz")}
        return {"source": self.source, "cycles": count, **means}

    def difference(self, values: F, measured: F) -> F:
        """Return values minus measured ones; NaN for the measurement itself."""
        return values - measured if self.source != MEASURED else np.full_like(values, np.nan)


def peak_rows(one: SourceValues) -> Iterator[PeakForce]:
    """Yield the peak velocity pick-up in both directions."""
    for direction in DIRECTIONS:
        half, measured = one.values.halves[direction], one.measured.halves[direction]
        difference = one.difference(half.peak_force, measured.peak_force)
        yield PeakForce(
            **one.key,
            direction=direction,
            speed_m_s=mean(half.peak_speed),
            force_N=mean(half.peak_force),
            force_sd_N=spread(half.peak_force),
            difference_N=mean(difference),
            difference_sd_N=spread(difference),
            note=FEW if one.key["cycles"] < MIN_CYCLES else "",
        )


def continuous_rows(one: SourceValues) -> Iterator[ContinuousForce]:
    """Yield force and hysteresis at shares of the peak speed in both directions."""
    for direction in DIRECTIONS:
        half, measured = one.values.halves[direction], one.measured.halves[direction]
        difference, width = one.difference(half.mean, measured.mean), half.width
        speed = mean(half.peak_speed)
        for k, share in enumerate(SHARES):
            yield ContinuousForce(
                **one.key,
                direction=direction,
                speed_m_s=float(share) * speed,
                accelerating_N=mean(half.accelerating[:, k]),
                decelerating_N=mean(half.decelerating[:, k]),
                force_N=mean(half.mean[:, k]),
                force_sd_N=spread(half.mean[:, k]),
                width_N=mean(width[:, k]),
                width_sd_N=spread(width[:, k]),
                difference_N=mean(difference[:, k]),
            )


def loop_rows(one: SourceValues) -> Iterator[LoopPoint]:
    """Yield the mean loop, from full rebound over full compression back."""
    cycles, force = one.cycles, one.cycles.forces[one.source]
    for k in range(2 * HALF + 1):
        yield LoopPoint(
            **one.key,
            phase=k / (2 * HALF),
            position_m=mean(cycles.position[:, k]),
            speed_m_s=mean(cycles.speed[:, k]),
            force_N=mean(force[:, k]),
            force_sd_N=spread(force[:, k]),
        )


def work_row(one: SourceValues) -> CycleWork:
    """Return work, equivalent damping and the forces at zero speed."""
    values = one.values
    difference = one.difference(values.work_J, one.measured.work_J)
    middle, width = 0.5 * (values.top_N + values.bottom_N), values.top_N - values.bottom_N
    compression, rebound = (mean(values.halves[d].peak_force) for d in (COMPRESSION, REBOUND))
    dissipates = mean(values.work_J) > 0.0
    damped = dissipates and compression > 0.0 > rebound
    return CycleWork(
        **one.key,
        work_J=mean(values.work_J),
        work_sd_J=spread(values.work_J),
        power_W=mean(values.power_W),
        damping_Ns_m=mean(values.damping_Ns_m) if dissipates else np.nan,
        damping_sd_Ns_m=spread(values.damping_Ns_m) if dissipates else np.nan,
        mid_force_N=mean(middle),
        mid_force_sd_N=spread(middle),
        zero_width_N=mean(width),
        zero_width_sd_N=spread(width),
        zero_width_per_ms_N=mean(values.width_per_skew_N),
        rebound_ratio=-rebound / compression if damped else np.nan,
        difference_J=mean(difference),
        difference_sd_J=spread(difference),
        note=_describe_work(dissipates, damped),
    )


def knee_rows(one: SourceValues) -> Iterator[Knee]:
    """Yield the knee in both directions, or why there is none."""
    for direction in DIRECTIONS:
        knee = find_knee(one.values.halves[direction])
        key = {**one.key, "direction": direction}
        if isinstance(knee, KneeFit):
            yield Knee(
                **key,
                knee_speed_m_s=knee.speed_m_s,
                knee_speed_sd_m_s=knee.speed_sd_m_s,
                knee_force_N=knee.force_N,
                slope_below_Ns_m=knee.slope_below_Ns_m,
                slope_above_Ns_m=knee.slope_above_Ns_m,
            )
        else:
            yield Knee(**key, note=knee)


def mean(values: F) -> float:
    """Return the mean of the finite values, NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def spread(values: F) -> float:
    """Return the standard deviation of the finite values, NaN for fewer than MIN_CYCLES."""
    known = values[np.isfinite(values)]
    return float(known.std(ddof=1)) if len(known) >= MIN_CYCLES else np.nan


def _describe_work(dissipates: bool, damped: bool) -> str:
    if not dissipates:
        return "the loop dissipates nothing: check the sign of force or position, or the delay between them"
    return "" if damped else "one direction does not resist: no ratio (offset of the force?)"
