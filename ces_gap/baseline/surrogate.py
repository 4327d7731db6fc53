"""The surrogate of a simulation that cannot be run again, or only slowly: it predicts the effect of changed inputs.

Only differences are used: the surrogate's error at the recorded inputs, which is known, is added to its prediction for
the changed inputs, so that the force at the recorded inputs is exact. A simulation does not know what time it is: if an
effect moves the motion in time, the error is moved with it, and a pure delay of all inputs is exact, too.

Candidates are physical models alone, the same with a dictionary for the rest, and a dictionary alone. The simpler one
is kept unless the other is clearly better on blocks left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_gap.baseline.learner import Dictionary, Scales, learn
from ces_gap.baseline.physical import PhysicalForce, SurrogateExample, change_one_by_one, fit_physical_forces, left_out
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.grid import rms
from ces_gap.trace import Trace, TraceInputs, usable_values
from ces_observer.json_text import JsonObject

SCHEMA = "ces-surrogate/2"
UNKNOWN_ERROR = 1.0  # share of a difference: nothing is known about the error
MAX_MODELS = 4
INTERPOLATION_ERROR = 0.4  # of a change of force, at currents far from recorded ones: measured on hydraulic dampers


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
            "dictionary": None if self.dictionary is None else asdict(self.dictionary),
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
        return self.surrogate.predict(trace, inputs) + carry_error(self.error, trace, inputs)

    def error_of_change(self, trace: Trace, inputs: TraceInputs) -> F:
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


CLEARLY_BETTER = 0.6  # of the cost J: a dictionary takes twice the models' time, and gains less on changes
SHARPNESS = 2.0  # of the weights: inverse squared errors
MIN_CHANGE = 0.005  # of the RMS force: a smaller change says nothing about the error of changes


@dataclass(frozen=True)
class _Candidate:
    """A surrogate and its predictions [N] of each example, on the ticks left out without their own force."""

    surrogate: Surrogate
    predicted: tuple[F, ...]


def learn_surrogate(examples: Sequence[SurrogateExample], traces: Sequence[Trace]) -> Surrogate:
    """Return the surrogate learnt from the examples, which are of these traces."""
    nothing = _Candidate(Surrogate((), None, np.empty(0), np.inf), tuple(np.zeros(len(e.force)) for e in examples))
    physical, alone = _add_models(examples), _learn_rest(examples, nothing)
    candidates = [physical, _learn_rest(examples, physical), alone] if physical.surrogate.models else [alone]
    best = candidates[0]
    for other in candidates[1:]:
        if other.surrogate.cost_J < CLEARLY_BETTER * best.surrogate.cost_J:
            best = other
    error = estimate_difference_error(_with_error(best.surrogate, physical.surrogate, traces), traces)
    return replace(best.surrogate, difference_error=error)


def estimate_difference_error(surrogate: Surrogate, traces: Sequence[Trace]) -> float:
    """Return the median over typical changes of inputs: RMS error of the change of force, as a share of the change."""
    kinds = zip(*(change_one_by_one(t) for t in traces), strict=True)
    shares = []
    for kind in kinds:
        pairs = list(zip(traces, kind, strict=True))
        changes = usable_values(traces, [surrogate.force(t, inputs) - t.simulated for t, inputs in pairs])
        errors = usable_values(traces, [surrogate.error_of_change(t, inputs) for t, inputs in pairs])
        if rms(changes) > MIN_CHANGE * rms(usable_values(traces, [t.simulated for t in traces])):
            shares.append(rms(errors) / rms(changes))
    return float(np.median(shares)) if shares else UNKNOWN_ERROR


def _with_error(surrogate: Surrogate, other: Surrogate, traces: Sequence[Trace]) -> Surrogate:
    """Return a surrogate without two models with its error: how much it disagrees with another."""
    if len(surrogate.models) > 1 or not other.models or surrogate is other:
        return surrogate
    kinds = [(t, inputs) for t in traces for inputs in change_one_by_one(t)]
    one, two = (
        np.concatenate([s.force(t, inputs)[t.usable] - t.simulated[t.usable] for t, inputs in kinds])
        for s in (surrogate, other)
    )
    return replace(surrogate, difference_error=rms(one - two) / max(rms(one), 1e-9))


def _add_models(examples: Sequence[SurrogateExample]) -> _Candidate:
    """Return the mean of the physical models, each weighted by the inverse square of its error on left-out blocks."""
    models = fit_physical_forces(examples)
    each = [tuple(m.predict(e.inputs, e.trace.rate_Hz) for e in examples) for m in models]
    costs = [cost_on_left_out(examples, predicted) for predicted in each]
    known = [k for k, cost in enumerate(costs) if np.isfinite(cost)]
    weights = np.array([max(costs[k], 1e-6) ** -SHARPNESS for k in known])
    shares = weights / max(float(weights.sum()), 1e-300)
    predicted = tuple(
        sum((s * each[k][n] for s, k in zip(shares, known, strict=True)), np.zeros(len(e.force)))
        for n, e in enumerate(examples)
    )
    shared = tuple(SharedForce(float(s), models[k]) for s, k in zip(shares, known, strict=True))
    cost = cost_on_left_out(examples, predicted) if shared else np.inf
    return _Candidate(Surrogate(shared, None, np.empty(0), cost), predicted)


def _learn_rest(examples: Sequence[SurrogateExample], physical: _Candidate) -> _Candidate:
    """Return the candidate with a dictionary for what it leaves; a dictionary alone does not know the force."""
    traces, by_force = [replace(e.trace, inputs=e.inputs) for e in examples], bool(physical.surrogate.models)
    targets = [e.force - p for e, p in zip(examples, physical.predicted, strict=True)]
    dictionary = Dictionary(Scales.of(traces, [e.force for e in examples]), by_force=by_force)
    features = [dictionary.features(e.trace, e.inputs, p) for e, p in zip(examples, physical.predicted, strict=True)]
    learnt = learn(features, targets, [t.usable for t in traces], traces[0].rate_Hz, passes=1)
    predicted = tuple(p + rest for p, rest in zip(physical.predicted, learnt.crossfitted, strict=True))
    cost_J = cost_on_left_out(examples, predicted)
    surrogate = replace(physical.surrogate, dictionary=dictionary, weights=learnt.weights, cost_J=cost_J)
    return _Candidate(surrogate, predicted)


def cost_on_left_out(examples: Sequence[SurrogateExample], predicted: Sequence[F]) -> float:
    """Return the cost J [%] of predictions [N] on the blocks left out; infinite if one is not finite."""
    used = [left_out(e) for e in examples]
    if not any(u.any() for u in used):
        used = [e.trace.usable for e in examples]
    true = np.concatenate([e.force[u] for e, u in zip(examples, used, strict=True)])
    error = true - np.concatenate([p[u] for p, u in zip(predicted, used, strict=True)])
    if not np.isfinite(error).all():
        return float("inf")
    return 100.0 * float(np.linalg.norm(error)) / max(float(np.linalg.norm(true - true.mean())), 1e-9)
