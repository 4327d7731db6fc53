"""Conditions: cycles of one current, amplitude and frequency, and their values by a source beside the measured ones.

Force over current at a speed: magnetic hysteresis between raised and lowered currents, range, ratio and linearity.
Conditions of one amplitude and frequency are a test point; with target speeds, those whose speed is near to one. The
softest and the hardest setting are the ends of the current, in the order of the resistance measured there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import t as student

from ces_data.arrays import F, I, Mask
from ces_identify.characteristics.cycles import COMPRESSION, DIRECTIONS, Cycles, CycleValues, group_values
from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.rows import ControlRange, CurrentForce
from ces_identify.characteristics.rules import BRANCHES, BenchRules
from ces_identify.limits import DynoLimits, ErrorLimits

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


SOFT_RESISTS_NOT = "no resistance at the softest current: no ratio (gas force or offset?)"
Key = tuple[str, str, float, float]


def list_over_current(values: Sequence[SourceValues]) -> tuple[CurrentForce, ...]:
    """Return the rows of every test point with two currents or more, by direction, source and rising current."""
    rows = [row for point in _group_points(values) for direction in DIRECTIONS for row in _list_rows(point, direction)]
    flip = _hard_is_low(rows)
    return tuple(row for curve in group_curves(rows).values() for row in _with_shares(curve, flip))


def list_ranges(rows: Sequence[CurrentForce]) -> tuple[ControlRange, ...]:
    """Return the range of each source, test point and direction."""
    flip, ranges = _hard_is_low(rows), dict[Key, ControlRange]()
    for key, curve in group_curves(rows).items():
        if len(curve) > 1:
            ranges[key] = _make_range(curve[::-1] if flip else curve, ranges.get((MEASURED, *key[1:])))
    return tuple(ranges.values())


def group_curves(rows: Sequence[CurrentForce]) -> dict[Key, list[CurrentForce]]:
    """Return the rows of each curve over current, by source, direction, amplitude and frequency."""
    curves: dict[Key, list[CurrentForce]] = {}
    for row in rows:
        curves.setdefault((row.source, row.direction, row.amplitude_m, row.frequency_Hz), []).append(row)
    return curves


def is_same_test(row: Any, other: Any) -> bool:
    """Return whether two rows have nearly the same amplitude and frequency."""
    ratios = np.array([other.amplitude_m / row.amplitude_m, other.frequency_Hz / row.frequency_Hz])
    return bool((np.abs(np.log(ratios)) <= 2.0 * DynoLimits.SAME).all())


def _group_points(values: Sequence[SourceValues]) -> Iterator[list[SourceValues]]:
    """Yield the conditions of each test point by rising speed; with target speeds only those near to one."""
    points: list[list[SourceValues]] = []
    for one in values:
        point = next((point for point in points if is_same_test(point[0], one)), None)
        if point is None:
            points.append(point := [])
        point.append(one)
    for point in sorted(points, key=lambda p: p[0].amplitude_m * p[0].frequency_Hz):
        currents = {one.key["current_A"] for one in point}
        targets = point[0].rules.speeds_m_s
        if len(currents) > 1 and (not targets or np.isfinite(_target_of(point))):
            yield point


def _target_of(point: Sequence[SourceValues]) -> float:
    """Return the target speed that both directions together are near to; NaN if there is none."""
    speeds = [abs(mean(one.forces(direction)[0])) for one in point for direction in DIRECTIONS]
    return point[0].target(float(np.mean(speeds)))


def _list_rows(point: Sequence[SourceValues], direction: str) -> Iterator[CurrentForce]:
    shared = {
        "direction": direction,
        "target_m_s": _target_of(point),
        "amplitude_m": float(np.mean([one.amplitude_m for one in point])),
        "frequency_Hz": float(np.mean([one.frequency_Hz for one in point])),
    }
    held: dict[tuple[str, float], list[SourceValues]] = {}
    for one in point:
        held.setdefault((one.key["source"], one.key["current_A"]), []).append(one)
    for source in dict.fromkeys(source for source, _ in held):
        for (name, _), own in sorted(held.items()):
            if name == source:
                yield _make_row(own, direction, shared)


def _make_row(own: Sequence[SourceValues], direction: str, shared: dict[str, Any]) -> CurrentForce:
    """Return the row of one current: `own` are its conditions, which differ in the centre of the stroke."""
    speed, force, difference = (
        np.concatenate(parts) for parts in zip(*(v.forces(direction) for v in own), strict=True)
    )
    branch = np.concatenate([one.cycles.branch[one.chosen] for one in own])
    raised, lowered = (
        force[(branch == which) & np.isfinite(force)] for which in (BRANCHES["raised"], BRANCHES["lowered"])
    )
    sign = 1.0 if direction == COMPRESSION else -1.0
    return CurrentForce(
        **{name: own[0].key[name] for name in ("source", "current_A", "current_width_A")},
        **shared,
        cycles=int(np.isfinite(force).sum()),
        speed_m_s=mean(speed),
        **with_sd("force", "N", force),
        raw_N=mean(force) - own[0].rules.gas_force_N,
        raised_N=mean(raised),
        lowered_N=mean(lowered),
        width_N=sign * (mean(lowered) - mean(raised)),
        width_ci95_N=_half_interval(*(_sd_and_count(values) for values in (raised, lowered))),
        **with_sd("difference", "N", difference),
    )


def _with_shares(curve: Sequence[CurrentForce], flip: bool) -> Iterator[CurrentForce]:
    """Yield the rows of a curve with what depends on its ends: linearity, and hysteresis over range."""
    soft, hard = (curve[-1].force_N, curve[0].force_N) if flip else (curve[0].force_N, curve[-1].force_N)
    whole = hard - soft or np.nan
    for row in curve:
        yield replace(row, linearity=(row.force_N - soft) / whole, width_share=row.width_N / abs(whole))


def _make_range(curve: Sequence[CurrentForce], measured: ControlRange | None) -> ControlRange:
    """Return the range of a curve from the softest to the hardest current."""
    soft, hard = curve[0], curve[-1]
    sign = 1.0 if soft.direction == COMPRESSION else -1.0
    spreads = [(row.force_sd_N, row.cycles) for row in (soft, hard)]
    resists, width = sign * soft.force_N > 0.0, sign * (hard.force_N - soft.force_N)
    ratio = hard.force_N / soft.force_N if resists else np.nan
    relative = [(sd / row.force_N, n) for row, (sd, n) in zip((soft, hard), spreads, strict=True)]
    if measured is not None and (measured.soft_A, measured.hard_A) != (soft.current_A, hard.current_A):
        measured = None  # a simulation without a force at an end
    widest = max((row for row in curve if np.isfinite(row.width_N)), key=lambda row: abs(row.width_N), default=None)
    shared = {
        name: getattr(soft, name) for name in ("source", "direction", "target_m_s", "amplitude_m", "frequency_Hz")
    }
    return ControlRange(
        **shared,
        speed_m_s=float(np.mean([row.speed_m_s for row in curve])),
        soft_A=soft.current_A,
        hard_A=hard.current_A,
        soft_N=soft.force_N,
        hard_N=hard.force_N,
        range_N=width,
        range_ci95_N=_half_interval(*spreads),
        ratio=ratio,
        ratio_ci95=abs(ratio) * _half_interval(*relative),
        hysteresis_N=np.nan if widest is None else widest.width_N,
        hysteresis_ci95_N=np.nan if widest is None else widest.width_ci95_N,
        difference_N=np.nan if measured is None else width - measured.range_N,
        difference_ratio=np.nan if measured is None else ratio - measured.ratio,
        note="" if resists else SOFT_RESISTS_NOT,
    )


def _hard_is_low(rows: Sequence[CurrentForce]) -> bool:
    """Return whether the damper resists more at the lowest current than at the highest."""
    curves = group_curves([row for row in rows if row.source == MEASURED]).values()
    rise = [(c[-1].force_N - c[0].force_N) * (1.0 if c[0].direction == COMPRESSION else -1.0) for c in curves]
    return sum(rise) < 0.0


def _sd_and_count(values: F) -> tuple[float, int]:
    return (float(values.std(ddof=1)) if len(values) >= DynoLimits.MIN_REPEATS else np.nan), len(values)


def _half_interval(*spreads: tuple[float, int]) -> float:
    """Return half the 95 % interval of a difference of means, from standard deviation and count of each; NaN for few.

    The smaller count gives the degrees of freedom, so it is never too narrow (Welch's test has at least as many).
    """
    if min(count for _, count in spreads) < DynoLimits.MIN_REPEATS:
        return np.nan
    error = np.sqrt(sum(sd**2 / count for sd, count in spreads))
    return float(student.ppf(0.5 + ErrorLimits.LEVEL / 2, min(count for _, count in spreads) - 1) * error)
