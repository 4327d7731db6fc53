"""The characteristics of recordings: cycles recorded alike and their tables, and force over speed of any motion.

Cycles of one level of current, amplitude and frequency are a condition, with a row in each table. Any motion is shown
by quantiles of the force in bins of speed, which need no cycles, so they also describe noise and roads. Lags, stroke
and history spread the forces; the quantiles show by how much. Where the current keeps to a few levels the samples of
steady current are grouped by level, elsewhere into equal ranges of current.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_data.reading import RecordingInputs, as_recordings
from ces_identify.characteristics.cycles import (
    COMPRESSION,
    DIRECTIONS,
    HALF,
    REBOUND,
    SHARES,
    Cycles,
    CycleValues,
    evaluate_cycles,
    find_cycles,
    group_values,
    join_cycles,
    steady_current,
)
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch, prepare_motion
from ces_identify.characteristics.rows import (
    Characteristics,
    ContinuousForce,
    CycleWork,
    LoopPoint,
    PeakForce,
    RecordingFacts,
    SpeedBin,
    find_omissions,
)
from ces_identify.characteristics.steps import average_steps, group_steps, read_steps
from ces_identify.limits import BinLimits, DynoLimits
from ces_identify.numerics.correlation import noise_rms
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError

BINS = 32
RANGES = 4
RANGE_QUANTILE = 0.998  # of |speed|, the edge of the outermost bins
QUANTILES = (0.1, 0.5, 0.9)
FEW = f"fewer than {DynoLimits.MIN_REPEATS} cycles: no spread"
NOTHING_DISSIPATED = "the loop dissipates nothing: check the sign of force or position, or the delay between them"
NO_RATIO = "one direction does not resist: no ratio (offset of the force?)"
Condition = tuple[I, dict[str, float]]  # the cycles (indices, rising), and the columns that describe them


def characterise(
    recordings: RecordingInputs, *, simulations: Mapping[str, Simulation | Sequence[F]] | None = None
) -> Characteristics:
    """Return the characteristics of recordings with a measured force, and of simulations run over them.

    `simulations` holds, by name, simulations or their forces [N] at the position samples of each recording. Raises
    CesError for a recording that cannot be used.
    """
    given = as_recordings(recordings)
    if MEASURED in (simulations or {}):
        raise CesError(f"a simulation is named '{MEASURED}'; expected another name")
    forces = {
        name: list(source) if isinstance(source, Sequence) else [source.force(recording) for recording in given]
        for name, source in (simulations or {}).items()
    }
    motions = [prepare_motion(r, {name: force[k] for name, force in forces.items()}) for k, r in enumerate(given)]
    stretches = [stretch for motion in motions for stretch in motion.stretches]
    if not stretches:
        raise CesError(f"{given[0].name}: no stretch of position and current without a gap is long enough")
    sources, tolerance = (MEASURED, *forces), current_tolerance(stretches)
    parts = [
        find_cycles(stretch, number, tolerance, motion.speed_noise_m_s, motion.bandwidth_Hz)
        for number, motion in enumerate(motions)
        for stretch in motion.stretches
    ]
    cycles = join_cycles(parts)
    tables = cycle_tables(cycles.select(cycles.used), tolerance, sources)
    read = [step for motion in motions for step in read_steps(motion, sources, tolerance)]
    steps, means = tuple(step.row for step in read), [average_steps(group) for group in group_steps(read, tolerance)]
    return Characteristics(
        sources=sources,
        current_tolerance_A=tolerance,
        recordings=tuple(_describe(motion, k, cycles) for k, motion in enumerate(motions)),
        **tables,
        responses=tuple(response for response, _ in means),
        response_points=tuple(point for _, points in means for point in points),
        steps=steps,
        speed_bins=tuple(row for source in sources for row in fill_bins(stretches, source, tolerance)),
        omissions=tuple(find_omissions(motions, cycles, steps, tables["work"])),
    )


def _describe(motion: RecordingMotion, number: int, cycles: Cycles) -> RecordingFacts:
    own = cycles.recording == number
    facts = {name: value for name, value in vars(motion).items() if name != "stretches"}
    return RecordingFacts(**facts, cycles=int(own.sum()), cycles_used=int((own & cycles.used).sum()))


def fill_bins(stretches: Sequence[Stretch], source: str, tolerance_A: float) -> Iterator[SpeedBin]:
    """Yield the bins with enough samples and visits, by current and speed."""
    current = np.concatenate([s.current for s in stretches])
    speed = np.concatenate([s.speed for s in stretches])
    force = np.concatenate([s.forces[source] for s in stretches])
    steady = np.concatenate([steady_current(s, tolerance_A) for s in stretches])
    reach = float(np.quantile(np.abs(speed), RANGE_QUANTILE))
    edges = np.linspace(-reach, reach, BINS + 1)
    cell = np.searchsorted(edges, speed, side="right") - 1
    for low_A, high_A, members in _group_by_current(current, steady, tolerance_A):
        places = members[np.isfinite(force[members])]  # the groups are the recording's, also without a simulated force
        for index in range(BINS):
            inside = places[cell[places] == index]
            visits = 1 + int((np.diff(inside) > 1).sum())
            if len(inside) >= BinLimits.MIN_SAMPLES and visits >= DynoLimits.MIN_REPEATS:
                low, median, high = (float(q) for q in np.quantile(force[inside], QUANTILES))
                yield SpeedBin(
                    source=source,
                    current_from_A=low_A,
                    current_to_A=high_A,
                    speed_from_m_s=float(edges[index]),
                    speed_to_m_s=float(edges[index + 1]),
                    samples=len(inside),
                    visits=visits,
                    low_N=low,
                    median_N=median,
                    high_N=high,
                )


def _group_by_current(current: F, steady: Mask, tolerance: float) -> Iterator[tuple[float, float, I]]:
    """Yield lowest, highest and members (indices) of each level, or of each range if there are no levels."""
    finite = np.isfinite(current)
    held = np.flatnonzero(finite & steady)
    levels = group_values(current[held], tolerance) if len(held) >= BinLimits.MIN_STEADY * finite.sum() else []
    if 0 < len(levels) <= BinLimits.MAX_LEVELS:
        for level in levels:
            yield float(current[held[level]].min()), float(current[held[level]].max()), np.sort(held[level])
        return
    low, high = np.percentile(current[finite], (1.0, 99.0)) if finite.any() else (0.0, 0.0)
    for a, b in pairwise(np.linspace(low, high, RANGES + 1)):
        inside = (current >= a) & (current < b if b < high else current <= b)
        yield float(a), float(b), np.flatnonzero(finite & inside)


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
            of_source = SourceValues({"source": source, "cycles": count, **columns}, chosen, values, measured)
            for name, make_rows in ROWS_OF.items():
                if count >= (1 if name == "peak_velocity" else DynoLimits.MIN_REPEATS):
                    tables[name] += make_rows(of_source)
    return {name: tuple(rows) for name, rows in tables.items()}


def current_tolerance(stretches: Sequence[Stretch]) -> float:
    """Return by how much [A] currents may differ and still count as the same."""
    largest, noise = 0.0, 0.0
    for current in (s.current[np.isfinite(s.current)] for s in stretches):
        if len(current):
            largest = max(largest, float(np.percentile(np.abs(current), 99.0)))
        changes = current[np.diff(current, prepend=np.nan) != 0.0]  # held samples would hide the noise
        noise = max(noise, noise_rms(changes if len(changes) > 0.1 * len(current) else current))
    return max(DynoLimits.SAME * largest, DynoLimits.BEYOND_NOISE * noise, 1e-9)


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


def peak_rows(source: SourceValues) -> Iterator[PeakForce]:
    """Yield the peak velocity pick-up in both directions."""
    for direction in DIRECTIONS:
        half, measured = source.values.halves[direction], source.measured.halves[direction]
        yield PeakForce(
            **source.key,
            direction=direction,
            speed_m_s=mean(half.peak_speed),
            **_with_sd("force", "N", half.peak_force),
            **_with_sd("difference", "N", source.difference(half.peak_force, measured.peak_force)),
            note=FEW if source.key["cycles"] < DynoLimits.MIN_REPEATS else "",
        )


def continuous_rows(source: SourceValues) -> Iterator[ContinuousForce]:
    """Yield force and hysteresis at shares of the peak speed in both directions."""
    for direction in DIRECTIONS:
        half, measured = source.values.halves[direction], source.measured.halves[direction]
        difference, force, width = source.difference(half.mean, measured.mean), half.mean, half.width
        speed = mean(half.peak_speed)
        for k, share in enumerate(SHARES):
            yield ContinuousForce(
                **source.key,
                direction=direction,
                speed_m_s=float(share) * speed,
                accelerating_N=mean(half.accelerating[:, k]),
                decelerating_N=mean(half.decelerating[:, k]),
                **_with_sd("force", "N", force[:, k]),
                **_with_sd("width", "N", width[:, k]),
                difference_N=mean(difference[:, k]),
            )


def loop_rows(source: SourceValues) -> Iterator[LoopPoint]:
    """Yield the mean loop, from full rebound over full compression back."""
    for k in range(2 * HALF + 1):
        yield LoopPoint(
            **source.key,
            phase=k / (2 * HALF),
            position_m=mean(source.cycles.position[:, k]),
            speed_m_s=mean(source.cycles.speed[:, k]),
            **_with_sd("force", "N", source.cycles.forces[source.key["source"]][:, k]),
        )


def work_rows(source: SourceValues) -> Iterator[CycleWork]:
    """Yield work, equivalent damping and the forces at zero speed."""
    values = source.values
    compression, rebound = (mean(values.halves[d].peak_force) for d in (COMPRESSION, REBOUND))
    dissipates = mean(values.work_J) > 0.0
    damped = dissipates and compression > 0.0 > rebound
    yield CycleWork(
        **source.key,
        **_with_sd("work", "J", values.work_J),
        power_W=mean(values.power_W),
        **(_with_sd("damping", "Ns_m", values.damping_Ns_m) if dissipates else {}),
        **_with_sd("mid_force", "N", 0.5 * (values.top_N + values.bottom_N)),
        **_with_sd("zero_width", "N", values.top_N - values.bottom_N),
        zero_width_per_ms_N=mean(values.width_per_skew_N),
        rebound_ratio=-rebound / compression if damped else np.nan,
        **_with_sd("difference", "J", source.difference(values.work_J, source.measured.work_J)),
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
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else np.nan


def _with_sd(name: str, unit: str, values: F) -> dict[str, Any]:
    """Return the columns of a mean and its standard deviation between cycles, NaN for fewer than MIN_REPEATS."""
    finite = values[np.isfinite(values)]
    sd = float(finite.std(ddof=1)) if len(finite) >= DynoLimits.MIN_REPEATS else np.nan
    return {f"{name}_{unit}": mean(values), f"{name}_sd_{unit}": sd}
