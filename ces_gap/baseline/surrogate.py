"""A stand-in for a simulation that cannot be run again, or only slowly: what changed inputs would have done to it.

Only differences are taken from it: the simulated force stays, and what the learner says of changed inputs less what
it says of the recorded ones is added, so that most of the learner's own error cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import learn
from ces_gap.baseline.learner_kernels import low_passed
from ces_gap.baseline.plant import Rerun
from ces_gap.trace import Inputs, Trace

F = NDArray[np.float64]

LATE_S, LAG_S, YIELD = 0.004, 0.012, 0.05  # [s], [s], share of the stroke: changes from which the surrogate learns


@dataclass(frozen=True)
class Surrogate(Rerun):
    """Weights (q,) of the dictionary's features, and its cost J [%] (thesis eq. 3.5) on blocks it did not see."""

    dictionary: Dictionary
    weights: F
    cost_J: float

    def force(self, trace: Trace, inputs: Inputs) -> F:
        """Return the simulated force [N] (n,) that the inputs would have given."""
        return self.prepare_for(trace).force(trace, inputs)

    def prepare_for(self, trace: Trace) -> Rerun:
        """Return the same for this trace alone: what it predicts for the recorded inputs is computed once."""
        return _Prepared(self, self.predict(trace, trace.inputs))

    def predict(self, trace: Trace, inputs: Inputs) -> F:
        """Return the whole force [N] (n,) that it predicts for the inputs, nothing taken from the simulated one."""
        return self.dictionary.told(trace, inputs, np.zeros(len(trace)), self.weights)

    def as_json(self) -> dict[str, Any]:
        """Return the surrogate as plain values."""
        return {"dictionary": self.dictionary.as_json(), "weights": self.weights.tolist(), "cost_J": self.cost_J}

    @classmethod
    def from_json(cls, given: dict[str, Any]) -> Surrogate:
        """Return the surrogate that `as_json` wrote; raises KeyError, TypeError or ValueError for others."""
        weights = np.array(given["weights"], dtype=np.float64)
        return cls(Dictionary.from_json(given["dictionary"]), weights, float(given["cost_J"]))


@dataclass(frozen=True)
class _Prepared(Rerun):
    """A surrogate for one trace, and the force [N] (n,) that it predicts for the recorded inputs."""

    surrogate: Surrogate
    recorded: F

    def force(self, trace: Trace, inputs: Inputs) -> F:
        return trace.simulated + self.surrogate.predict(trace, inputs) - self.recorded


@dataclass(frozen=True)
class Example:
    """Inputs on a trace's grid and the force [N] (n,) simulated for them."""

    trace: Trace
    inputs: Inputs
    force: F


def learn_surrogate(examples: Sequence[Example]) -> Surrogate:
    """Return the surrogate that the examples teach."""
    traces, forces = [e.trace for e in examples], [e.force for e in examples]
    dictionary = Dictionary(Scales.of(traces, forces), by_force=False)
    features = [dictionary.features(e.trace, e.inputs, np.zeros(len(e.trace))) for e in examples]
    usable = [t.usable for t in traces]
    learnt = learn(features, forces, usable, traces[0].rate_Hz, passes=1)
    true = np.concatenate([f[u] for f, u in zip(forces, usable, strict=True)])
    told = np.concatenate([p[u] for p, u in zip(learnt.crossfitted, usable, strict=True)])
    spread = float(np.linalg.norm(true - true.mean()))
    return Surrogate(dictionary, learnt.weights, 100.0 * float(np.linalg.norm(true - told)) / max(spread, 1e-9))


def recorded(traces: Sequence[Trace]) -> list[Example]:
    """Return the traces as examples of themselves."""
    return [Example(t, t.inputs, t.simulated) for t in traces]


def explored(traces: Sequence[Trace], simulation: Rerun) -> list[Example]:
    """Return examples of what changed inputs do, each trace run twice more: late and lagging, yielding and weaker."""
    examples = recorded(traces)
    for trace in traces:
        for inputs in _changed(trace):
            examples.append(Example(trace, inputs, simulation.force(trace, inputs)))
    return examples


def _changed(trace: Trace) -> list[Inputs]:
    """Return two sets of inputs unlike the recorded ones in ways that effects are."""
    plain, rate = trace.inputs, trace.rate_Hz
    late = np.interp(trace.time_s - LATE_S, trace.time_s, plain.position)
    lagging = 1.1 * low_passed(plain.current, trace.step_s, LAG_S)
    yielding = plain.position - YIELD * float(np.ptp(plain.position)) * trace.simulated / np.ptp(trace.simulated)
    return [plain.moved(late, rate).powered(lagging), plain.moved(yielding, rate).powered(0.95 * plain.current)]
