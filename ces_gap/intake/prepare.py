"""The intake: recordings and a simulation in; traces to fit on, to judge on and free of the effect out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.baseline.plant import DirectSimulator, TraceSimulator
from ces_gap.baseline.surrogate import Surrogate, learn_surrogate, make_changed_examples, make_recorded_examples
from ces_gap.errors import GapError
from ces_gap.intake.saturation import exclude_saturated_ticks
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace, open_trace, require_usable
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation, find_predictions

MIN_FIT_S = 4.0  # [s] usable for the fit
PARTS, PART_S = 10, 1.0  # of a single recording, the shortest [s]: every third is set aside
SLOW_S = 0.025  # [s] of computing: a rerun of all real recordings that is slower is asked seldom


@dataclass(frozen=True)
class DiagnosisInput:
    """Traces to fit on, to judge on, and free of the effect.

    `exact` runs the simulation again (None if it cannot be), `cheap` does so quickly: by `surrogate`, if there is one.
    """

    real: tuple[Trace, ...]
    held_out: tuple[Trace, ...]
    reference: tuple[Trace, ...]
    exact: TraceSimulator | None
    cheap: TraceSimulator
    surrogate: Surrogate | None

    @property
    def best(self) -> TraceSimulator:
        """What reruns the simulation best: itself, or the surrogate of what was only recorded."""
        return self.exact or self.cheap

    @property
    def slow(self) -> TraceSimulator | None:
        """The simulation itself where a surrogate replaces it in the search, None where it is run at once or never."""
        return None if self.surrogate is None else self.exact


def prepare_recordings(
    simulation: Simulation,
    real: Sequence[Recording],
    held_out: Sequence[Recording],
    reference: Sequence[Recording],
    progress: Progress = ignore_progress,
) -> DiagnosisInput:
    """Return everything on its grid; recordings to judge on are set aside if none are given. Raises GapError."""
    roles = [(real, not held_out), (held_out, True), (reference, False)]  # with whether the gap is judged on them
    count, begun = len(real) + len(held_out) + len(reference), 0
    traces: list[list[Trace]] = []
    for recordings, judged_on in roles:
        traces.append([])
        for recording in recordings:
            progress(f"simulating {recording.name}", begun / count)
            trace = exclude_saturated_ticks(open_trace(simulation, recording, also_as_logged=judged_on))
            require_usable(trace)
            traces[-1].append(trace)
            begun += 1
    fitted, judged, free = traces
    if not judged:
        fitted, judged = set_aside(fitted)
    _require_length(fitted)
    exact, cheap, surrogate = _make_simulators(simulation, fitted, [*judged, *free])
    return DiagnosisInput(tuple(fitted), tuple(judged), tuple(free), exact, cheap, surrogate)


def set_aside(traces: Sequence[Trace]) -> tuple[list[Trace], list[Trace]]:
    """Return traces to fit on and to judge on: the last third of the recordings, or every third part of one."""
    if len(traces) > 1:
        kept = len(traces) - max(1, len(traces) // 3)
        return list(traces[:kept]), list(traces[kept:])
    only = traces[0]
    part = np.maximum(PART_S, only.time_s[-1] / PARTS)
    judged = (only.time_s / part).astype(np.int64) % 3 == 2
    fitted = replace(only, usable=only.usable & ~judged)
    return [fitted], [replace(only, usable=only.usable & judged, map_ticks=fitted.usable)]


def _require_length(traces: Sequence[Trace]) -> None:
    seconds = sum(float(t.usable.sum()) / t.rate_Hz for t in traces)
    if seconds < MIN_FIT_S:
        raise GapError(
            f"{', '.join(t.name for t in traces)}: {seconds:.1f} s are left to fit on; "
            f"expected at least {MIN_FIT_S:g} s; give longer or more --real recordings"
        )


def _make_simulators(
    simulation: Simulation, fitted: Sequence[Trace], others: Sequence[Trace]
) -> tuple[TraceSimulator | None, TraceSimulator, Surrogate | None]:
    """Return who reruns the simulation exactly and quickly; the slow or only recorded one gets a surrogate."""
    if find_predictions(simulation) is not None:
        surrogate = learn_surrogate(make_recorded_examples([*fitted, *others]))
        return None, surrogate, surrogate
    called = DirectSimulator(simulation)
    began = time.process_time()
    for trace in fitted:
        called.force(trace, trace.inputs)
    if time.process_time() - began <= SLOW_S:
        return called, called, None
    surrogate = learn_surrogate([*make_changed_examples(fitted, called), *make_recorded_examples(others)])
    return called, surrogate, surrogate
