"""The surrogate of a simulation that cannot be run again, or only slowly: it predicts the effect of changed inputs.

Only differences are used: the surrogate's error at the recorded inputs, which is known, is added to its prediction for
the changed inputs, so that the force at the recorded inputs is exact. A simulation does not know what time it is: if an
effect moves the motion in time, the error is moved with it, and a pure delay of all inputs is exact, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_gap.baseline.dictionary import Dictionary
from ces_gap.baseline.physical_force import PhysicalForce
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.trace import F, Trace, TraceInputs
from ces_observer.json_checks import JsonObject

SCHEMA = "ces-surrogate/2"
UNKNOWN_ERROR = 1.0  # share of a difference: nothing is known about the error
MAX_MODELS = 4
INTERPOLATION_ERROR = (
    0.4  # share of a change of force at currents far from recorded ones: measured on hydraulic dampers
)


@dataclass(frozen=True)
class SharedForce:
    """A physical model and its share of the sum."""

    share: float
    model: PhysicalForce


@dataclass(frozen=True)
class Surrogate(TraceSimulator):
    """The weighted mean of physical models, plus the weights (q,) of a dictionary's features for the rest, if any.

    `cost_J` is the cost J [%] (thesis eq. 3.5) on blocks left out of the fit. `difference_error` is the estimated RMS
    error of the change of force by typical changes of the inputs, as a share of the RMS of that change.
    """

    models: tuple[SharedForce, ...]
    dictionary: Dictionary | None
    weights: F
    cost_J: float
    difference_error: float = UNKNOWN_ERROR

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,) for the inputs."""
        return self.prepare_for(trace).force(trace, inputs)

    def prepare_for(self, trace: Trace) -> TraceSimulator:
        """Return the surrogate with its error at the recorded inputs computed once."""
        return _Prepared(self, trace.simulated - self.predict(trace, trace.inputs))

    def predict(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the predicted force [N] (n,) for the inputs, independent of the simulated force."""
        force = np.zeros(len(trace))
        for one in self.models:
            force += one.share * one.model.predict(inputs, trace.rate_Hz)
        if self.dictionary is None:
            return force
        return np.asarray(force + self.dictionary.predict(trace, inputs, force, self.weights))

    def error_of_change(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the standard error [N] (n,) of the change of force from the recorded inputs to `inputs`.

        It is how much two models of different structure disagree, and a share of what is only interpolated between
        recorded currents. Without two models it is the share `difference_error` of the change.
        """
        change = self.force(trace, inputs) - trace.simulated
        if len(self.models) < 2:
            return np.asarray(self.difference_error * np.abs(change))
        one, other = (replace(self, models=(replace(m, share=1.0),), dictionary=None) for m in self.models[:2])
        disagreement = one.force(trace, inputs) - other.force(trace, inputs)
        beyond = INTERPOLATION_ERROR * self.models[0].model.distance_from_currents(trace, inputs)
        return np.asarray(np.hypot(disagreement, beyond * change))

    def as_json(self) -> dict[str, Any]:
        """Return the surrogate as plain values."""
        return {
            "schema": SCHEMA,
            "models": [{"share": one.share, **one.model.as_json()} for one in self.models],
            "dictionary": None if self.dictionary is None else self.dictionary.as_json(),
            "weights": self.weights.tolist(),
            "cost_J": self.cost_J,
            "difference_error": self.difference_error,
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Surrogate:
        """Return the surrogate from `as_json`, or of a file from before there were physical models in it.

        Raises KeyError, TypeError, ValueError or ModelError if the document is not one.
        """
        if document.get("schema", SCHEMA) != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}; expected {SCHEMA!r}")
        root = JsonObject(document, "surrogate")
        models: tuple[SharedForce, ...] = ()
        if "schema" in document:
            nodes = root.items("models", 0, MAX_MODELS)
            models = tuple(SharedForce(n.number("share", 0.0, 1.0), PhysicalForce.from_json(n)) for n in nodes)
        weights = np.array(document["weights"], dtype=np.float64)
        dictionary = None if document["dictionary"] is None else Dictionary.from_json(document["dictionary"])
        if dictionary is not None:
            dictionary.require_weights(weights)
        error = root.number("difference_error", 0.0) if "difference_error" in document else UNKNOWN_ERROR
        return cls(models, dictionary, weights, float(document["cost_J"]), error)


@dataclass(frozen=True)
class _Prepared(TraceSimulator):
    """A surrogate for one trace; `error` [N] (n,) is simulated minus predicted force at the recorded inputs."""

    surrogate: Surrogate
    error: F

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,) for the inputs."""
        return self.surrogate.predict(trace, inputs) + carry_error(self.error, trace, inputs)

    def error_of_change(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the standard error [N] (n,) of the change of force."""
        return self.surrogate.error_of_change(trace, inputs)


def carry_error(error: F, trace: Trace, inputs: TraceInputs) -> F:
    """Return the error [N] (n,) at the recorded inputs moved in time as the changed motion is.

    The delay is that of the position that fits the change best, in least squares: x - x' = delay v.
    """
    speed = trace.inputs.speed
    moved = trace.inputs.position - inputs.position
    size = float(speed @ speed)
    delay_s = float(speed @ moved) / size if size > 0.0 else 0.0
    return error if delay_s == 0.0 else np.interp(trace.time_s - delay_s, trace.time_s, error)
