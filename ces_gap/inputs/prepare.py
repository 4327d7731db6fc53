"""The inputs of a diagnosis: recordings and a simulation in; traces to fit, to validate and as references out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_data.recording import Recording
from ces_gap.baseline.identified import add_left_out_force
from ces_gap.baseline.physical import make_changed_examples, make_recorded_examples
from ces_gap.baseline.plant import DirectSimulator, TraceSimulator
from ces_gap.baseline.surrogate import Surrogate, learn_surrogate
from ces_gap.errors import GapError
from ces_gap.inputs.checks import exclude_saturated_ticks
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace, open_trace, require_usable
from ces_identify.numerics import search_clock
from ces_identify.simulations.simulation import Simulation, find_predictions

MIN_FIT_S = 4.0  # [s] usable for the fit
PARTS, PART_S = 10, 1.0  # of a single recording, shortest part [s]; every third part is held out
SLOW_S = 0.025  # [s] of processor time: a simulation that is slower over all real recordings gets a surrogate
SLOW_CLOCK_S = 0.25  # [s] of the clock: the same for one that waits, for a file or for another process


@dataclass(frozen=True)
class DiagnosisInput:
    """Traces for the fit (`real`), for validation (`held_out`) and as `reference`.

    `exact` runs the simulation (None if it cannot be run); `cheap` is the `surrogate` if there is one, else `exact`.
    """

    real: tuple[Trace, ...]
    held_out: tuple[Trace, ...]
    reference: tuple[Trace, ...]
    exact: TraceSimulator | None
    cheap: TraceSimulator
    surrogate: Surrogate | None

    @property
    def best(self) -> TraceSimulator:
        """The simulation itself, or the surrogate of recorded predictions."""
        return self.exact or self.cheap

    @property
    def slow(self) -> TraceSimulator | None:
        """The simulation if a surrogate replaces it in the search, otherwise None."""
        return None if self.surrogate is None else self.exact


def prepare_recordings(
    simulation: Simulation,
    real: Sequence[Recording],
    held_out: Sequence[Recording],
    reference: Sequence[Recording],
    progress: Progress = ignore_progress,
) -> DiagnosisInput:
    """Return the traces of all recordings; without `held_out` a part of `real` is set aside. Raises GapError."""
    roles = [(real, not held_out), (held_out, True), (reference, False)]  # True: needs the force on the logged position
    count, done = len(real) + len(held_out) + len(reference), 0
    traces: list[list[Trace]] = []
    for recordings, also_as_logged in roles:
        traces.append([])
        for recording in recordings:
            progress(f"simulating {recording.name}", done / count)
            trace = exclude_saturated_ticks(open_trace(simulation, recording, also_as_logged))
            require_usable(trace)
            traces[-1].append(trace)
            done += 1
    fitted, held, references = traces
    references = [add_left_out_force(simulation, trace) for trace in references]
    if not held:
        fitted, held = set_aside(fitted)
    seconds = sum(float(t.usable.sum()) / t.rate_Hz for t in fitted)
    if seconds < MIN_FIT_S:
        raise GapError(
            f"{', '.join(t.name for t in fitted)}: {seconds:.1f} s remain for the fit; "
            f"expected at least {MIN_FIT_S:g} s; pass longer or more --real recordings"
        )
    exact, cheap, surrogate = _make_simulators(simulation, fitted, [*held, *references])
    return DiagnosisInput(tuple(fitted), tuple(held), tuple(references), exact, cheap, surrogate)


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


def _make_simulators(
    simulation: Simulation, fitted: Sequence[Trace], others: Sequence[Trace]
) -> tuple[TraceSimulator | None, TraceSimulator, Surrogate | None]:
    """Return `exact`, `cheap` and `surrogate` of `DiagnosisInput`: slow or recorded simulations get a surrogate."""
    if find_predictions(simulation) is not None:
        surrogate = learn_surrogate(make_recorded_examples([*fitted, *others]), [*fitted, *others])
        return None, surrogate, surrogate
    direct = DirectSimulator(simulation)
    for _ in range(2):  # what compiles first, or is held up once, is not slow
        processor, clock = time.process_time(), search_clock.now()
        for trace in fitted:
            direct.force(trace, trace.inputs)
        if time.process_time() - processor <= SLOW_S and search_clock.now() - clock <= SLOW_CLOCK_S:
            return direct, direct, None
    examples = [*make_changed_examples(fitted, direct), *make_recorded_examples(others)]
    surrogate = learn_surrogate(examples, [*fitted, *others])
    return direct, surrogate, surrogate
