"""The surrogate of a simulation that cannot be run again, or only slowly: it predicts the effect of changed inputs.

Only differences are used: the prediction for changed inputs minus the one for the recorded inputs is added to the
simulated force, so that most of the learner's error cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import learn
from ces_gap.baseline.learner_kernels import low_pass
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.trace import F, Trace, TraceInputs

LATE_S, LAG_S, YIELD = 0.004, 0.012, 0.05  # [s], [s], share of the stroke: changes of the inputs in the examples


@dataclass(frozen=True)
class Surrogate(TraceSimulator):
    """Weights (q,) of the dictionary's features, and its cost J [%] (thesis eq. 3.5) on held-out blocks."""

    dictionary: Dictionary
    weights: F
    cost_J: float

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,) for the inputs."""
        return self.prepare_for(trace).force(trace, inputs)

    def prepare_for(self, trace: Trace) -> TraceSimulator:
        """Return the surrogate with its prediction for the recorded inputs computed once."""
        return _Prepared(self, self.predict(trace, trace.inputs))

    def predict(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the predicted force [N] (n,) for the inputs, independent of the simulated force."""
        return self.dictionary.predict(trace, inputs, np.zeros(len(trace)), self.weights)

    def as_json(self) -> dict[str, Any]:
        """Return the surrogate as plain values."""
        return {"dictionary": self.dictionary.as_json(), "weights": self.weights.tolist(), "cost_J": self.cost_J}

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> Surrogate:
        """Return the surrogate from `as_json`; raises KeyError, TypeError or ValueError if the document is not one."""
        weights = np.array(document["weights"], dtype=np.float64)
        return cls(Dictionary.from_json(document["dictionary"]), weights, float(document["cost_J"]))


@dataclass(frozen=True)
class _Prepared(TraceSimulator):
    """A surrogate for one trace; `recorded` is its prediction [N] (n,) for the recorded inputs."""

    surrogate: Surrogate
    recorded: F

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        return trace.simulated + self.surrogate.predict(trace, inputs) - self.recorded


@dataclass(frozen=True)
class SurrogateExample:
    """Inputs on a trace's grid and the force [N] (n,) simulated for them."""

    trace: Trace
    inputs: TraceInputs
    force: F


def learn_surrogate(examples: Sequence[SurrogateExample]) -> Surrogate:
    """Return the surrogate learnt from the examples."""
    traces, forces = [replace(e.trace, inputs=e.inputs) for e in examples], [e.force for e in examples]
    dictionary = Dictionary(Scales.of(traces, forces), by_force=False)
    features = [dictionary.features(e.trace, e.inputs, np.zeros(len(e.trace))) for e in examples]
    usable = [t.usable for t in traces]
    learnt = learn(features, forces, usable, traces[0].rate_Hz, passes=1)
    true = np.concatenate([f[u] for f, u in zip(forces, usable, strict=True)])
    predicted = np.concatenate([p[u] for p, u in zip(learnt.crossfitted, usable, strict=True)])
    spread = float(np.linalg.norm(true - true.mean()))
    return Surrogate(dictionary, learnt.weights, 100.0 * float(np.linalg.norm(true - predicted)) / max(spread, 1e-9))


def make_recorded_examples(traces: Sequence[Trace]) -> list[SurrogateExample]:
    """Return the recorded inputs and simulated forces of the traces as examples."""
    return [SurrogateExample(t, t.inputs, t.simulated) for t in traces]


def make_changed_examples(traces: Sequence[Trace], simulation: TraceSimulator) -> list[SurrogateExample]:
    """Return the recorded examples, and two with changed inputs for each trace, computed by `simulation`."""
    examples = make_recorded_examples(traces)
    changed = ((trace, inputs) for trace in traces for inputs in _change_inputs(trace))
    return examples + [SurrogateExample(t, inputs, simulation.force(t, inputs)) for t, inputs in changed]


def _change_inputs(trace: Trace) -> list[TraceInputs]:
    """Return two typical changes of the inputs by effects: late and lagging; yielding with a weaker current."""
    plain, rate = trace.inputs, trace.rate_Hz
    late = np.interp(trace.time_s - LATE_S, trace.time_s, plain.position)
    lagging = 1.1 * low_pass(plain.current, trace.step_s, LAG_S)
    yielding = plain.position - YIELD * float(np.ptp(plain.position)) * trace.simulated / np.ptp(trace.simulated)
    return [
        plain.with_position(late, rate).with_current(lagging),
        plain.with_position(yielding, rate).with_current(0.95 * plain.current),
    ]
