"""Recordings go in, the tables of a damper dyno come out; with simulations, the same from their forces beside them.

Cycles and steps are found in position and current alone, so every simulation is read at exactly the same instants.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ces_identify.characteristics.conditions import Condition, current_tolerance, find_conditions
from ces_identify.characteristics.cycle_rows import (
    MIN_CYCLES,
    SourceValues,
    continuous_rows,
    knee_rows,
    loop_rows,
    peak_rows,
    work_row,
)
from ces_identify.characteristics.cycle_values import evaluate_cycles
from ces_identify.characteristics.cycles import Cycles, find_cycles, join_cycles
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch, prepare_motion
from ces_identify.characteristics.omissions import find_empty_values, find_omissions
from ces_identify.characteristics.results import Characteristics, RecordingFacts
from ces_identify.characteristics.rows import SpeedBin
from ces_identify.characteristics.speed_bins import bin_forces
from ces_identify.characteristics.step_rows import group_steps, read_steps, response_points, response_row
from ces_identify.numerics.arrays import F
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError


def characterise(
    recordings: Recording | Sequence[Recording], *, simulations: Mapping[str, Simulation | Sequence[F]] | None = None
) -> Characteristics:
    """Return the characteristics of recordings with a measured force, and of simulations run over them.

    `simulations` holds, by name, simulations or their forces [N] at the position samples of each recording. Raises
    CesError for a recording that cannot be used.
    """
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    forces = _simulate(given, simulations or {})
    motions = [prepare_motion(one, {name: force[k] for name, force in forces.items()}) for k, one in enumerate(given)]
    stretches = [stretch for motion in motions for stretch in motion.stretches]
    if not stretches:
        raise CesError(f"{given[0].name}: no stretch of position and current without a gap is long enough")
    sources, tolerance = (MEASURED, *forces), current_tolerance(stretches)
    found = _find_cycles(motions, tolerance)
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


def _find_cycles(motions: Sequence[RecordingMotion], tolerance: float) -> Cycles:
    return join_cycles(
        [
            find_cycles(stretch, number, tolerance, motion.speed_noise_m_s, motion.bandwidth_Hz)
            for number, motion in enumerate(motions)
            for stretch in motion.stretches
        ]
    )


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
