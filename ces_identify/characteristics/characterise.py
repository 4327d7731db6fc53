"""Force over speed of any motion: quantiles of the force in bins of speed, for each level or range of current.

Needs no cycles, so it also describes noise and roads. Lags, stroke and history spread the forces; the quantiles show
by how much. Where the current keeps to a few levels the samples of steady current are grouped by level, elsewhere into
equal ranges of current.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_data.reading import RecordingInputs, as_recordings
from ces_data.recording import Recording
from ces_identify.characteristics.cycle_rows import (
    MIN_CYCLES,
    Condition,
    SourceValues,
    continuous_rows,
    current_tolerance,
    find_conditions,
    group_values,
    knee_rows,
    loop_rows,
    peak_rows,
    work_row,
)
from ces_identify.characteristics.cycles import Cycles, evaluate_cycles, find_cycles, join_cycles, steady_current
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch, prepare_motion
from ces_identify.characteristics.rows import (
    Characteristics,
    RecordingFacts,
    SpeedBin,
    find_empty_values,
    find_omissions,
)
from ces_identify.characteristics.steps import group_steps, read_steps, response_points, response_row
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError

BINS = 32
RANGES = 4
MAX_LEVELS = 12
MIN_STEADY = 0.5  # share of samples at a steady current, for levels
RANGE_QUANTILE = 0.998  # of |speed|, the edge of the outermost bins
MIN_SAMPLES = 30
MIN_VISITS = 3  # separate passes through a bin: samples of one pass are not independent
QUANTILES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class BinnedForce:
    """One bin: `current_A` and `speed_m_s` as (low, high), and the QUANTILES of the force [N]."""

    current_A: tuple[float, float]
    speed_m_s: tuple[float, float]
    samples: int
    visits: int
    force_N: tuple[float, float, float]


def bin_forces(stretches: Sequence[Stretch], source: str, tolerance_A: float) -> list[BinnedForce]:
    """Return the bins with enough samples and visits, by current and speed."""
    current, speed, force, steady = (_join(stretches, source, tolerance_A, k) for k in range(4))
    if not len(speed):
        return []
    reach = float(np.quantile(np.abs(speed), RANGE_QUANTILE))
    edges = np.linspace(-reach, reach, BINS + 1)
    cell = np.clip(np.searchsorted(edges, speed, side="right") - 1, -1, BINS)
    results = []  # the groups are those of the recording, also where a simulation has no force yet
    for low, high, members in _current_groups(current, steady.astype(np.bool_), np.isfinite(current), tolerance_A):
        results += _fill_bins(edges, cell, members & np.isfinite(force), force, (low, high))
    return results


def _current_groups(current: F, steady: Mask, known: Mask, tolerance: float) -> list[tuple[float, float, Mask]]:
    """Return (lowest, highest, members (n,)) of each level, or of each range if there are no levels."""
    held = known & steady
    if held.sum() >= MIN_STEADY * known.sum():
        groups = group_values(np.where(held, current, np.nan)[held], tolerance)
        if len(groups) <= MAX_LEVELS:
            places = np.flatnonzero(held)
            return [_as_group(current, places[group]) for group in groups]
    low, high = np.percentile(current[known], (1.0, 99.0)) if known.any() else (0.0, 0.0)
    edges = np.linspace(low, high, RANGES + 1)
    return [
        (float(a), float(b), known & (current >= a) & (current < b if b < high else current <= b))
        for a, b in pairwise(edges)
    ]


def _as_group(current: F, places: I) -> tuple[float, float, Mask]:
    members = np.zeros(len(current), np.bool_)
    members[places] = True
    return float(current[places].min()), float(current[places].max()), members


def _fill_bins(edges: F, cell: I, members: Mask, force: F, current: tuple[float, float]) -> list[BinnedForce]:
    places = np.flatnonzero(members & (cell >= 0) & (cell < len(edges) - 1))
    if not len(places):
        return []
    order = places[np.argsort(cell[places], kind="stable")]
    bins, starts = np.unique(cell[order], return_index=True)
    filled = []
    for index, inside in zip(bins, np.split(order, starts[1:]), strict=True):
        visits = 1 + int((np.diff(inside) > 1).sum())
        if len(inside) >= MIN_SAMPLES and visits >= MIN_VISITS:
            low, middle, high = (float(q) for q in np.quantile(force[inside], QUANTILES))
            speeds = (float(edges[index]), float(edges[index + 1]))
            filled.append(BinnedForce(current, speeds, len(inside), visits, (low, middle, high)))
    return filled


def _join(stretches: Sequence[Stretch], source: str, tolerance: float, which: int) -> F:
    """Return one column of all samples: current, speed, force, or whether the current is steady."""
    columns = (
        lambda s: s.current,
        lambda s: s.speed,
        lambda s: s.forces[source],
        lambda s: steady_current(s, tolerance).astype(np.float64),
    )
    return np.concatenate([np.empty(0), *(columns[which](s) for s in stretches)])


def characterise(
    recordings: RecordingInputs, *, simulations: Mapping[str, Simulation | Sequence[F]] | None = None
) -> Characteristics:
    """Return the characteristics of recordings with a measured force, and of simulations run over them.

    `simulations` holds, by name, simulations or their forces [N] at the position samples of each recording. Raises
    CesError for a recording that cannot be used.
    """
    given = as_recordings(recordings)
    forces = _simulate(given, simulations or {})
    motions = [prepare_motion(one, {name: force[k] for name, force in forces.items()}) for k, one in enumerate(given)]
    stretches = [stretch for motion in motions for stretch in motion.stretches]
    if not stretches:
        raise CesError(f"{given[0].name}: no stretch of position and current without a gap is long enough")
    sources, tolerance = (MEASURED, *forces), current_tolerance(stretches)
    found = join_cycles(
        [
            find_cycles(stretch, number, tolerance, motion.speed_noise_m_s, motion.bandwidth_Hz)
            for number, motion in enumerate(motions)
            for stretch in motion.stretches
        ]
    )
    used = found.select(found.used)
    read = [step for motion in motions for step in read_steps(motion, sources, tolerance)]
    steps, groups = tuple(step.row for step in read), group_steps(read, tolerance)
    cycle_tables = _cycle_tables(used, find_conditions(used, tolerance), sources)
    return Characteristics(
        sources=sources,
        current_tolerance_A=tolerance,
        recordings=tuple(_describe(motion, k, found) for k, motion in enumerate(motions)),
        **cycle_tables,
        responses=tuple(response_row(group) for group in groups),
        response_points=tuple(point for group in groups for point in response_points(group)),
        steps=steps,
        speed_bins=tuple(row for source in sources for row in _bin_rows(stretches, source, tolerance)),
        omissions=(*find_omissions(motions, found, steps), *find_empty_values(cycle_tables["work"])),
    )


def _simulate(
    recordings: Sequence[Recording], simulations: Mapping[str, Simulation | Sequence[F]]
) -> dict[str, list[F]]:
    if MEASURED in simulations:
        raise CesError(f"a simulation is named '{MEASURED}'; expected another name")
    return {
        name: list(one) if isinstance(one, Sequence) else [one.force(recording) for recording in recordings]
        for name, one in simulations.items()
    }


def _cycle_tables(cycles: Cycles, conditions: Sequence[Condition], sources: Sequence[str]) -> dict[str, Any]:
    """Return the tables about cycles; those that need a spread leave out conditions with too few cycles."""
    peaks, continuous, loops, work, knees = [], [], [], [], []
    for one in _source_values(cycles, conditions, sources):
        peaks += list(peak_rows(one))
        if one.key["cycles"] >= MIN_CYCLES:
            continuous += list(continuous_rows(one))
            loops += list(loop_rows(one))
            work.append(work_row(one))
            knees += list(knee_rows(one))
    return {
        "peak_velocity": tuple(peaks),
        "continuous": tuple(continuous),
        "loops": tuple(loops),
        "work": tuple(work),
        "knees": tuple(knees),
    }


def _source_values(cycles: Cycles, conditions: Sequence[Condition], sources: Sequence[str]) -> Iterator[SourceValues]:
    for condition in conditions:
        members = np.zeros(len(cycles.current_A), np.bool_)
        members[condition.cycles] = True
        chosen = cycles.select(members)
        measured = evaluate_cycles(chosen, MEASURED)
        for source in sources:
            values = measured if source == MEASURED else evaluate_cycles(chosen, source)
            if np.isfinite(values.work_J).any():
                yield SourceValues(source, condition, chosen, values, measured)


def _bin_rows(stretches: Sequence[Stretch], source: str, tolerance: float) -> Iterator[SpeedBin]:
    for one in bin_forces(stretches, source, tolerance):
        yield SpeedBin(
            source=source,
            current_from_A=one.current_A[0],
            current_to_A=one.current_A[1],
            speed_from_m_s=one.speed_m_s[0],
            speed_to_m_s=one.speed_m_s[1],
            samples=one.samples,
            visits=one.visits,
            low_N=one.force_N[0],
            median_N=one.force_N[1],
            high_N=one.force_N[2],
        )


def _describe(motion: RecordingMotion, number: int, cycles: Cycles) -> RecordingFacts:
    own = cycles.recording == number
    kept = {f.name: getattr(motion, f.name) for f in fields(RecordingFacts) if hasattr(motion, f.name)}
    return RecordingFacts(**kept, cycles=int(own.sum()), cycles_used=int((own & cycles.used).sum()))
