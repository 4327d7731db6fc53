"""What a surrogate learns from: inputs of a trace, as recorded or changed, and the force simulated for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_gap.baseline.learner_kernels import low_pass
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.trace import F, Trace, TraceInputs

LATE_S, LAG_S, YIELD = 0.004, 0.012, 0.05  # [s], [s], share of the stroke: changes of the inputs in the examples
STRONGER, WEAKER = 1.1, 0.9  # shares of the current in the examples


@dataclass(frozen=True)
class SurrogateExample:
    """Inputs on a trace's grid and the force [N] (n,) simulated for them."""

    trace: Trace
    inputs: TraceInputs
    force: F


def make_recorded_examples(traces: Sequence[Trace]) -> list[SurrogateExample]:
    """Return the recorded inputs and simulated forces of the traces as examples."""
    return [SurrogateExample(t, t.inputs, t.simulated) for t in traces]


def make_changed_examples(traces: Sequence[Trace], simulation: TraceSimulator) -> list[SurrogateExample]:
    """Return the recorded examples, and two with changed inputs for each trace, computed by `simulation`."""
    examples = make_recorded_examples(traces)
    changed = ((trace, inputs) for trace in traces for inputs in _change_inputs(trace))
    return examples + [SurrogateExample(t, inputs, simulation.force(t, inputs)) for t, inputs in changed]


def change_one_by_one(trace: Trace) -> list[TraceInputs]:
    """Return typical changes of the inputs by effects: late, yielding, weaker current, lagging current."""
    plain = trace.inputs
    return [
        plain.with_position(_late(trace), trace.rate_Hz),
        plain.with_position(_yielding(trace), trace.rate_Hz),
        plain.with_current(WEAKER * plain.current),
        plain.with_current(low_pass(plain.current, trace.step_s, LAG_S)),
    ]


def _change_inputs(trace: Trace) -> list[TraceInputs]:
    """Return two typical changes of the inputs by effects: late and lagging; yielding with a weaker current."""
    plain, rate = trace.inputs, trace.rate_Hz
    lagging = STRONGER * low_pass(plain.current, trace.step_s, LAG_S)
    return [
        plain.with_position(_late(trace), rate).with_current(lagging),
        plain.with_position(_yielding(trace), rate).with_current(WEAKER * plain.current),
    ]


def _late(trace: Trace) -> F:
    return np.interp(trace.time_s - LATE_S, trace.time_s, trace.inputs.position)


def _yielding(trace: Trace) -> F:
    position = trace.inputs.position
    return np.asarray(position - YIELD * float(np.ptp(position)) * trace.simulated / np.ptp(trace.simulated))
