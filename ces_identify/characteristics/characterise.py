"""The characteristics of recordings, and force over speed of any motion: quantiles of the force in bins of speed.

The bins need no cycles, so they also describe noise and roads. Lags, stroke and history spread the forces; the
quantiles show by how much. Where the current keeps to a few levels the samples of steady current are grouped by level,
elsewhere into equal ranges of current.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_data.reading import RecordingInputs, as_recordings
from ces_identify.characteristics.cycle_rows import current_tolerance, cycle_tables, group_values
from ces_identify.characteristics.cycles import Cycles, find_cycles, join_cycles, steady_current
from ces_identify.characteristics.motion import MEASURED, RecordingMotion, Stretch, prepare_motion
from ces_identify.characteristics.rows import Characteristics, RecordingFacts, SpeedBin, find_omissions
from ces_identify.characteristics.steps import average_steps, group_steps, read_steps
from ces_identify.limits import BinLimits
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError

BINS = 32
RANGES = 4
RANGE_QUANTILE = 0.998  # of |speed|, the edge of the outermost bins
QUANTILES = (0.1, 0.5, 0.9)


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
        name: list(one) if isinstance(one, Sequence) else [one.force(recording) for recording in given]
        for name, one in (simulations or {}).items()
    }
    motions = [prepare_motion(one, {name: force[k] for name, force in forces.items()}) for k, one in enumerate(given)]
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
    steps, means = tuple(step.row for step in read), [average_steps(one) for one in group_steps(read, tolerance)]
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
            if len(inside) >= BinLimits.MIN_SAMPLES and visits >= BinLimits.MIN_VISITS:
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
