"""What a diagnosis is given, made ready: traces to fit on, to judge on, free of the effect; a simulation to rerun."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.baseline.plant import Called, Rerun
from ces_gap.baseline.surrogate import Surrogate, explored, learn_surrogate, recorded
from ces_gap.errors import GapError
from ces_gap.intake.saturation import without_saturated
from ces_gap.recorded import recorded_in
from ces_gap.trace import Trace, open_trace, require_usable
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation

LEAST_FIT_S = 4.0  # [s] usable for the fit
PARTS, PART_S = 10, 1.0  # of a single recording, the shortest [s]: every third is set aside
SLOW_S = 0.025  # [s] of computing: a rerun of all real recordings that is slower is asked seldom

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Given:
    """Traces to fit on, to judge on, and free of the effect.

    `exact` runs the simulation again (None if it cannot be), `cheap` does so quickly, perhaps by `surrogate`.
    """

    real: tuple[Trace, ...]
    held_out: tuple[Trace, ...]
    reference: tuple[Trace, ...]
    exact: Rerun | None
    cheap: Rerun
    surrogate: Surrogate | None


def make_ready(
    simulation: Simulation,
    real: Sequence[Recording],
    held_out: Sequence[Recording],
    reference: Sequence[Recording],
    progress: Progress,
) -> Given:
    """Return everything on its grid; recordings to judge on are set aside if none are given. Raises GapError."""
    everything = [*real, *held_out, *reference]
    traces: list[Trace] = []
    for recording in everything:
        progress(f"simulating {recording.name}", len(traces) / len(everything))
        trace = open_trace(simulation, recording, as_given=_judged(recording, held_out, real))
        traces.append(without_saturated(trace))
        require_usable(traces[-1])
    fitted, judged, free = (
        traces[: len(real)],
        traces[len(real) : len(real) + len(held_out)],
        traces[len(real) + len(held_out) :],
    )
    if not judged:
        fitted, judged = set_aside(fitted)
    _require_length(fitted)
    exact, cheap, surrogate = _reruns(simulation, fitted, [*judged, *free])
    return Given(tuple(fitted), tuple(judged), tuple(free), exact, cheap, surrogate)


def _judged(recording: Recording, held_out: Sequence[Recording], real: Sequence[Recording]) -> bool:
    """True if the gap is judged on this recording, and so needs the simulation on its position as logged."""
    return any(recording is r for r in (held_out or real))


def set_aside(traces: Sequence[Trace]) -> tuple[list[Trace], list[Trace]]:
    """Return traces to fit on and to judge on: the last third of the recordings, or every third part of one."""
    if len(traces) > 1:
        kept = len(traces) - max(1, len(traces) // 3)
        return list(traces[:kept]), list(traces[kept:])
    only = traces[0]
    part = np.maximum(PART_S, only.time_s[-1] / PARTS)
    judged = (only.time_s / part).astype(np.int64) % 3 == 2
    return [replace(only, usable=only.usable & ~judged)], [replace(only, usable=only.usable & judged)]


def _require_length(traces: Sequence[Trace]) -> None:
    seconds = sum(float(t.usable.sum()) / t.rate_Hz for t in traces)
    if seconds < LEAST_FIT_S:
        raise GapError(
            f"{', '.join(t.name for t in traces)}: {seconds:.1f} s are left to fit on; "
            f"expected at least {LEAST_FIT_S:g} s; give longer or more --real recordings"
        )


def _reruns(
    simulation: Simulation, fitted: Sequence[Trace], others: Sequence[Trace]
) -> tuple[Rerun | None, Rerun, Surrogate | None]:
    """Return who reruns the simulation exactly and quickly; the slow or only recorded one gets a surrogate."""
    if recorded_in(simulation) is not None:
        surrogate = learn_surrogate(recorded([*fitted, *others]))
        return None, surrogate, surrogate
    called = Called(simulation)
    began = time.process_time()
    for trace in fitted:
        called.force(trace, trace.inputs.moved(trace.inputs.position + 0.0, trace.rate_Hz))
    if time.process_time() - began <= SLOW_S:
        return called, called, None
    surrogate = learn_surrogate([*explored(fitted, called), *recorded(others)])
    return called, surrogate, surrogate
