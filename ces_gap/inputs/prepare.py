"""The inputs of a diagnosis: recordings and a simulation in; traces to fit, to validate and as references out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_data.recording import Recording
from ces_gap.baseline.identified import add_left_out_force, add_own_error
from ces_gap.baseline.plant import DirectSimulator, TraceSimulator
from ces_gap.baseline.twin import Twin
from ces_gap.baseline.twin_fit import find_own_twin, find_twin
from ces_gap.errors import GapError
from ces_gap.inputs.checks import exclude_saturated_ticks
from ces_gap.inputs.probe_result import NOT_PROBED, SimulationProbe
from ces_gap.inputs.probes import correct_inputs
from ces_gap.limits import DiagnosisLimits, TwinLimits
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace, open_trace, require_usable, with_simulation
from ces_identify.numerics.search import clock_s
from ces_identify.simulations.simulation import Simulation, find_predictions

PARTS, PART_S = 10, 1.0  # of a single recording, shortest part [s]; every third part is held out


@dataclass(frozen=True)
class DiagnosisInput:
    """Traces for the fit (`real`), for validation (`held_out`) and as `reference`.

    `exact` runs the simulation (None if it cannot be run); `cheap` is its `twin` where it cannot be run or is `slow`,
    else `exact`. All take their inputs as the `probe` has corrected them. There is no twin of a simulation that does
    not move.
    """

    real: tuple[Trace, ...]
    held_out: tuple[Trace, ...]
    reference: tuple[Trace, ...]
    exact: TraceSimulator | None
    cheap: TraceSimulator
    twin: Twin | None
    probe: SimulationProbe = NOT_PROBED
    is_corrected: bool = False  # whether parameters, inputs or references correct the simulation before effects do

    @property
    def best(self) -> TraceSimulator:
        """The simulation itself, or the twin of recorded predictions."""
        return self.exact or self.cheap

    @property
    def slow(self) -> TraceSimulator | None:
        """The simulation if its twin replaces it in the search, otherwise None."""
        return None if self.cheap is self.exact else self.exact

    @property
    def twin_problem(self) -> str:
        """Why no effect can be put inside the twin, empty if they can."""
        if self.twin is None:
            return "it hardly moves"
        return "" if self.twin.cost_J <= TwinLimits.MAX_COST_J else f"its twin leaves J {self.twin.cost_J:.3g} %"


def prepare_recordings(
    simulation: Simulation,
    real: Sequence[Recording],
    held_out: Sequence[Recording],
    reference: Sequence[Recording],
    progress: Progress = ignore_progress,
    threads: int = 1,
    needs_twin: bool = True,
    uncalibrated: tuple[Simulation, Twin | None] | None = None,
) -> DiagnosisInput:
    """Return the traces of all recordings; without `held_out` a part of `real` is set aside. Raises GapError.

    With `needs_twin`, a simulation that is run gets one, too: for effects inside the damper. The gap is that of the
    `uncalibrated` simulation, if given; its twin is near enough for effects inside.
    """
    original, known_twin = uncalibrated or (simulation, None)
    roles = [(real, not held_out), (held_out, True), (reference, False)]
    fitted, held, references = _open_traces(original, simulation, roles, progress)
    references = [add_left_out_force(simulation, trace) for trace in references]
    if not held:
        fitted, held = set_aside(fitted)
    _require_time(fitted)
    progress("probing the simulation", 0.0)
    probed, simulation = correct_inputs(simulation, fitted, references)
    if probed.corrected:
        fitted, held, references = (
            [with_simulation(t, simulation.force(t.recording)) for t in traces] for traces in (fitted, held, references)
        )
    if not references:
        fitted, held = ([add_own_error(simulation, t) for t in traces] for traces in (fitted, held))
    exact = None if find_predictions(simulation) is not None else DirectSimulator(simulation)
    is_slow = exact is None or runs_slowly(exact, fitted)
    twin = known_twin if not is_slow else None
    if twin is None and (needs_twin or is_slow):
        everything = [*fitted, *held, *references]
        twin = find_own_twin(simulation, everything) or find_twin(everything, threads, progress)
    cheap = twin if is_slow and twin is not None else exact
    if cheap is None:
        raise GapError(f"{', '.join(t.name for t in fitted)}: hardly any motion; expected strokes of the damper")
    is_corrected = bool(references or probed.corrected or original is not simulation)
    return DiagnosisInput(tuple(fitted), tuple(held), tuple(references), exact, cheap, twin, probed, is_corrected)


def _open_traces(
    original: Simulation, changed: Simulation, roles: Sequence[tuple[Sequence[Recording], bool]], progress: Progress
) -> list[list[Trace]]:
    """Return the traces of the recordings of each role, and with the `changed` simulation if it is another one.

    A role that needs it has the force of the original one on the logged position, too.
    """
    count, done = sum(len(recordings) for recordings, _ in roles), 0
    traces: list[list[Trace]] = []
    for recordings, also_as_logged in roles:
        traces.append([])
        for recording in recordings:
            progress(f"simulating {recording.name}", done / count)
            trace = exclude_saturated_ticks(open_trace(original, recording, also_as_logged))
            if original is not changed:
                trace = with_simulation(trace, changed.force(trace.recording))
            require_usable(trace)
            traces[-1].append(trace)
            done += 1
    return traces


def _require_time(fitted: Sequence[Trace]) -> None:
    """Raise GapError if too few seconds are usable for the fit."""
    seconds = sum(float(t.usable.sum()) / t.rate_Hz for t in fitted)
    if seconds < DiagnosisLimits.MIN_FIT_S:
        raise GapError(
            f"{', '.join(t.name for t in fitted)}: {seconds:.1f} s remain for the fit; "
            f"expected at least {DiagnosisLimits.MIN_FIT_S:g} s; pass longer or more real recordings"
        )


def set_aside(traces: Sequence[Trace]) -> tuple[list[Trace], list[Trace]]:
    """Return traces for fit and validation; held out are the last third of several, or every third part of one."""
    if len(traces) > 1:
        count = len(traces) - max(1, len(traces) // 3)
        return list(traces[:count]), list(traces[count:])
    only = traces[0]
    part = np.maximum(PART_S, only.time_s[-1] / PARTS)
    held = (only.time_s / part).astype(np.int64) % 3 == 2
    fitted = replace(only, usable=only.usable & ~held)
    return [fitted], [replace(only, usable=only.usable & held, map_ticks=fitted.usable)]


def runs_slowly(simulation: DirectSimulator, traces: Sequence[Trace]) -> bool:
    """Return whether a simulation takes too long for a search."""
    for _ in range(TwinLimits.RUNS):  # what compiles first, or is held up by other work, is not slow
        processor, clock = time.process_time(), clock_s()
        for trace in traces:
            simulation.force(trace, trace.inputs)
        if time.process_time() - processor <= TwinLimits.SLOW_S and clock_s() - clock <= TwinLimits.SLOW_CLOCK_S:
            return False
    return True
