"""Checks recordings against the envelope of a simulation that is a model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ces_gap.errors import GapError
from ces_gap.trace import F, Trace
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.validation.envelope_use import find_outside
from ces_observer.model import Model

MAX_OUTSIDE_SHARE = 0.5  # share of the time, above which a comparison is refused
NOTED_OUTSIDE_SHARE = 0.05  # share from which there is a note
SLACK = 0.02  # of a range: the differentiators of model and trace differ


def outside_notes(traces: Sequence[Trace], simulation: Simulation, name: str) -> Iterator[str]:
    """Yield a note, with the worst input, for each recording that is often outside the range of the simulation.

    Raises GapError if all together are outside for more than `MAX_OUTSIDE_SHARE` of the time.
    """
    model = model_inside(simulation)
    if model is None:
        return
    outside = {trace.name: _outside(model, trace) for trace in traces}
    ticks = np.array([int(t.usable.sum()) for t in traces])
    overall = float(ticks @ [outside[t.name][0] for t in traces]) / max(int(ticks.sum()), 1)
    if overall > MAX_OUTSIDE_SHARE:
        worst = max(outside, key=lambda n: outside[n][0])
        raise GapError(
            f"{name}: outside the range it was identified on for {overall:.0%} of the time, most in {worst} "
            f"({outside[worst][1]}); expected an overlap: identify on recordings like these, or diagnose on others"
        )
    for recording, (share, where) in outside.items():
        if share > NOTED_OUTSIDE_SHARE:
            yield (
                f"{recording}: {share:.0%} of the time outside the range {name} was identified on ({where}); part of "
                "the gap is extrapolation"
            )


def model_inside(simulation: Simulation) -> Model | None:
    """Return the model inside a simulation, None if there is none."""
    inside = simulation.innermost
    return inside.model if isinstance(inside, ModelSimulation) else None


def _outside(model: Model, trace: Trace) -> tuple[float, str]:
    """Return the share of usable ticks with an input outside the envelope, and the ranges of those inputs."""
    keep = trace.usable
    names = ("position", "speed", "current")
    values = {name: getattr(trace.inputs, name)[keep] for name in names}
    ranges = model.envelope.by_signal
    out = {signal: _beyond(values[signal], *ranges[signal]) for signal in values}
    text = "; ".join(map(str, find_outside(model, values)))
    return float(np.any(list(out.values()), axis=0).mean()), text


def _beyond(values: F, low: float, high: float) -> NDArray[np.bool_]:
    slack = SLACK * max(high - low, abs(high), abs(low))
    return np.asarray((values < low - slack) | (values > high + slack))
