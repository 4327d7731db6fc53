"""The characteristics of recordings: tables of cycles recorded alike, and force over speed of any motion.

Cycles of one level of current, amplitude and frequency are a condition, with a row in each table. Any motion is shown
by quantiles of the force in bins of speed, which need no cycles, so they also describe noise and roads. Lags, stroke
and history spread the forces; the quantiles show by how much. Where the current keeps to a few levels the samples of
steady current are grouped by level, elsewhere into equal ranges of current.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_data.reading import RecordingInputs, as_recordings
from ces_identify.characteristics.conditions import (
    SourceValues,
    find_conditions,
    list_over_current,
    list_ranges,
    mean,
    with_sd,
)
from ces_identify.characteristics.cycles import (
    COMPRESSION,
    DIRECTIONS,
    HALF,
    REBOUND,
    SHARES,
    Cycles,
    evaluate_cycles,
    find_branches,
    find_cycles,
    group_values,
    join_cycles,
    last_of_holds,
    steady_current,
)
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch, prepare_motion
from ces_identify.characteristics.rows import (
    Characteristics,
    ContinuousForce,
    ControlRange,
    CycleWork,
    JudgedValue,
    LoopPoint,
    PeakForce,
    RecordingFacts,
    SpeedBin,
    ValveResponse,
    find_omissions,
)
from ces_identify.characteristics.rules import (
    BRANCHES,
    LAST_CYCLE,
    BenchRules,
    CharacteristicLimits,
    RulesInput,
    load_rules,
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


def characterise(
    recordings: RecordingInputs,
    *,
    simulations: Mapping[str, Simulation | Sequence[F]] | None = None,
    rules: RulesInput = None,
) -> Characteristics:
    """Return the characteristics of recordings with a measured force, and of simulations run over them.

    `simulations` holds, by name, simulations or their forces [N] at the position samples of each recording; `rules` are
    those of a file or a mapping. Raises CesError for a recording that cannot be used, or for a wrong rule.
    """
    bench = load_rules(rules)
    given = as_recordings(recordings)
    if MEASURED in (simulations or {}):
        raise CesError(f"a simulation is named '{MEASURED}'; expected another name")
    forces = {
        name: list(source) if isinstance(source, Sequence) else [source.force(recording) for recording in given]
        for name, source in (simulations or {}).items()
    }
    motions = [
        prepare_motion(r, {name: f[k] for name, f in forces.items()}, bench.gas_force_N) for k, r in enumerate(given)
    ]
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
    cycles = replace(cycles, branch=find_branches(cycles, motions, tolerance, BRANCHES[bench.first_hold]))
    tables = cycle_tables(cycles.select(cycles.used), tolerance, sources, bench)
    read = [step for motion in motions for step in read_steps(motion, sources, tolerance, bench)]
    steps = tuple(step.row for step in read)
    means = [average_steps(group, bench) for group in group_steps(read, tolerance)]
    responses = tuple(response for response, _ in means)
    return Characteristics(
        rules=bench,
        sources=sources,
        current_tolerance_A=tolerance,
        recordings=tuple(_describe(motion, k, cycles) for k, motion in enumerate(motions)),
        **tables,
        responses=responses,
        response_points=tuple(point for _, points in means for point in points),
        steps=steps,
        speed_bins=tuple(row for source in sources for row in fill_bins(stretches, source, tolerance)),
        judged=tuple(judge(bench.limit, responses, tables["ranges"])),
        omissions=tuple(find_omissions(motions, cycles, steps, tables, bench)),
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


def cycle_tables(
    cycles: Cycles, tolerance_A: float, sources: Sequence[str], rules: BenchRules
) -> dict[str, tuple[Any, ...]]:
    """Return the tables about used cycles; those that need a spread leave out conditions with too few cycles."""
    tables: dict[str, list[Any]] = {name: [] for name in ROWS_OF}
    read: list[SourceValues] = []
    for indices, columns in find_conditions(cycles, tolerance_A):
        chosen = cycles.select(indices)
        measured = evaluate_cycles(chosen, MEASURED, rules)
        last = last_of_holds(chosen) if rules.cycles == LAST_CYCLE else np.ones(len(indices), np.bool_)
        for source in sources:
            values = measured if source == MEASURED else evaluate_cycles(chosen, source, rules)
            count = int(np.isfinite(values.work_J).sum())
            key = {"source": source, "cycles": count, **columns}
            of_source = SourceValues(key, chosen, values, measured, last, rules)
            read += [of_source] * (count > 0)
            for name, make_rows in ROWS_OF.items():
                if count >= (1 if name == "peak_velocity" else DynoLimits.MIN_REPEATS):
                    tables[name] += make_rows(of_source)
    over_current = list_over_current(read)
    beside = {"over_current": over_current, "ranges": list_ranges(over_current)}
    return {name: tuple(rows) for name, rows in tables.items()} | beside


def current_tolerance(stretches: Sequence[Stretch]) -> float:
    """Return by how much [A] currents may differ and still count as the same."""
    largest, noise = 0.0, 0.0
    for current in (s.current[np.isfinite(s.current)] for s in stretches):
        if len(current):
            largest = max(largest, float(np.percentile(np.abs(current), 99.0)))
        changes = current[np.diff(current, prepend=np.nan) != 0.0]  # held samples would hide the noise
        noise = max(noise, noise_rms(changes if len(changes) > 0.1 * len(current) else current))
    return max(DynoLimits.SAME * largest, DynoLimits.BEYOND_NOISE * noise, 1e-9)


def peak_rows(source: SourceValues) -> Iterator[PeakForce]:
    """Yield the force by the rules in both directions."""
    for direction in DIRECTIONS:
        speed, force, difference = source.forces(direction)
        yield PeakForce(
            **source.key | {"cycles": (count := int(np.isfinite(force).sum()))},
            direction=direction,
            target_m_s=source.target(mean(speed)),
            speed_m_s=mean(speed),
            **with_sd("force", "N", force),
            raw_N=mean(force) - source.rules.gas_force_N,
            **with_sd("difference", "N", difference),
            note=FEW if count < DynoLimits.MIN_REPEATS else "",
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
                **with_sd("force", "N", force[:, k]),
                **with_sd("width", "N", width[:, k]),
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
            **with_sd("force", "N", source.cycles.forces[source.key["source"]][:, k]),
        )


def work_rows(source: SourceValues) -> Iterator[CycleWork]:
    """Yield work, equivalent damping and the forces at zero speed."""
    values = source.values
    compression, rebound = (mean(values.halves[d].force) for d in (COMPRESSION, REBOUND))
    dissipates = mean(values.work_J) > 0.0
    damped = dissipates and compression > 0.0 > rebound
    yield CycleWork(
        **source.key,
        **with_sd("work", "J", values.work_J),
        power_W=mean(values.power_W),
        **(with_sd("damping", "Ns_m", values.damping_Ns_m) if dissipates else {}),
        **with_sd("mid_force", "N", 0.5 * (values.top_N + values.bottom_N)),
        **with_sd("zero_width", "N", values.top_N - values.bottom_N),
        zero_width_per_ms_N=mean(values.width_per_skew_N),
        rebound_ratio=-rebound / compression if damped else np.nan,
        **with_sd("difference", "J", source.difference(values.work_J, source.measured.work_J)),
        note="" if damped else NO_RATIO if dissipates else NOTHING_DISSIPATED,
    )


ROWS_OF: dict[str, Callable[[SourceValues], Iterator[Any]]] = {
    "peak_velocity": peak_rows,
    "continuous": continuous_rows,
    "loops": loop_rows,
    "work": work_rows,
}


WITHIN, OUTSIDE, UNDECIDED, UNKNOWN = "within", "outside", "undecided", "not known"
NO_INTERVAL = ", no interval"


@dataclass(frozen=True)
class JudgedColumn:
    """A column that a limit is for, that of its interval, and the factor to the unit of the limit."""

    name: str
    interval: str
    factor: float = 1.0
    at_least: bool = False


OF_STEPS: Mapping[str, JudgedColumn] = {
    "t63_ms": JudgedColumn("time_63_s", "time_63_ci95_s", 1e3),
    "t90_ms": JudgedColumn("time_90_s", "time_90_ci95_s", 1e3),
    "rise_ms": JudgedColumn("rise_s", "rise_ci95_s", 1e3),
    "settled_ms": JudgedColumn("settled_s", "settled_ci95_s", 1e3),
    "overshoot": JudgedColumn("overshoot", "overshoot_ci95"),
}
OF_RANGES: Mapping[str, JudgedColumn] = {
    "hysteresis_N": JudgedColumn("hysteresis_N", "hysteresis_ci95_N"),
    "range_N": JudgedColumn("range_N", "range_ci95_N", at_least=True),
    "ratio": JudgedColumn("ratio", "ratio_ci95", at_least=True),
}


def judge(
    limits: CharacteristicLimits, responses: Sequence[ValveResponse], ranges: Sequence[ControlRange]
) -> Iterator[JudgedValue]:
    """Yield a row for each value of which the rules give a limit, or one that says that there is no value."""
    steps = [(row, f"{row.from_A:.3g} to {row.to_A:.3g} A, {row.direction}") for row in responses]
    reaches = [(reach, reach.direction) for reach in ranges]
    for rows, columns, nothing in ((steps, OF_STEPS, "no step was read"), (reaches, OF_RANGES, "no two currents")):
        for name, column in columns.items():
            allowed = getattr(limits, name)
            if allowed is not None and not rows:
                yield JudgedValue(source=MEASURED, limit=name, subject=nothing, allowed=allowed, verdict=UNKNOWN)
            elif allowed is not None:
                for row, subject in rows:
                    yield _judge_row(row, f"{subject} at {abs(row.speed_m_s):.3g} m/s", name, column, allowed)


def _judge_row(row: Any, subject: str, name: str, column: JudgedColumn, allowed: float) -> JudgedValue:
    value, reach = (column.factor * getattr(row, one) for one in (column.name, column.interval))
    room = value - allowed if column.at_least else allowed - abs(value)
    known = (WITHIN if room >= 0.0 else OUTSIDE) + NO_INTERVAL * math.isnan(reach)
    return JudgedValue(
        source=row.source,
        limit=name,
        subject=subject,
        value=value,
        value_ci95=reach,
        allowed=allowed,
        verdict=UNDECIDED if abs(room) < reach else UNKNOWN if math.isnan(value) else known,
    )
