"""Learning a surrogate: examples in; physical models, the dictionary for what they leave, and the errors of both out.

Candidates are physical models alone, the same with a dictionary for the rest, and a dictionary alone. The simpler one
is kept unless the other is clearly better on blocks left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import learn
from ces_gap.baseline.physical_fit import fit_physical_forces, left_out
from ces_gap.baseline.surrogate import UNKNOWN_ERROR, SharedForce, Surrogate
from ces_gap.baseline.surrogate_examples import SurrogateExample, change_one_by_one
from ces_gap.trace import F, Trace

CLEARLY_BETTER = 0.6  # of the cost J: a dictionary takes twice the models' time, and gains less on changes
SHARPNESS = 2.0  # of the weights: inverse squared errors
MIN_CHANGE = 0.005  # of the RMS force: a smaller change says nothing about the error of changes


@dataclass(frozen=True)
class _Candidate:
    """A surrogate and its predictions [N] of each example, on the ticks left out without their own force."""

    surrogate: Surrogate
    predicted: tuple[F, ...]


def learn_surrogate(examples: Sequence[SurrogateExample]) -> Surrogate:
    """Return the surrogate learnt from the examples."""
    nothing = _Candidate(Surrogate((), None, np.empty(0), np.inf), tuple(np.zeros(len(e.force)) for e in examples))
    physical, alone = _add_models(examples), _learn_rest(examples, nothing)
    candidates = [physical, _learn_rest(examples, physical), alone] if physical.surrogate.models else [alone]
    best = candidates[0]
    for other in candidates[1:]:
        if other.surrogate.cost_J < CLEARLY_BETTER * best.surrogate.cost_J:
            best = other
    traces = list({id(e.trace): e.trace for e in examples}.values())
    error = estimate_difference_error(_with_error(best.surrogate, physical.surrogate, traces), traces)
    return replace(best.surrogate, difference_error=error)


def estimate_difference_error(surrogate: Surrogate, traces: Sequence[Trace]) -> float:
    """Return the median over typical changes of inputs: RMS error of the change of force, as a share of the change."""
    kinds = zip(*(change_one_by_one(t) for t in traces), strict=True)
    shares = []
    for kind in kinds:
        changes = _on_usable(traces, [surrogate.force(t, i) - t.simulated for t, i in zip(traces, kind, strict=True)])
        errors = _on_usable(traces, [surrogate.error_of_change(t, i) for t, i in zip(traces, kind, strict=True)])
        if _rms(changes) > MIN_CHANGE * _rms(_on_usable(traces, [t.simulated for t in traces])):
            shares.append(_rms(errors) / _rms(changes))
    return float(np.median(shares)) if shares else UNKNOWN_ERROR


def _with_error(surrogate: Surrogate, other: Surrogate, traces: Sequence[Trace]) -> Surrogate:
    """Return a surrogate without two models with its error: how much it disagrees with another."""
    if len(surrogate.models) > 1 or not other.models or surrogate is other:
        return surrogate
    kinds = [(t, inputs) for t in traces for inputs in change_one_by_one(t)]
    one, two = (
        [s.force(t, inputs)[t.usable] - t.simulated[t.usable] for t, inputs in kinds] for s in (surrogate, other)
    )
    apart, size = np.concatenate(one) - np.concatenate(two), np.concatenate(one)
    return replace(surrogate, difference_error=_rms(apart) / max(_rms(size), 1e-9))


def _on_usable(traces: Sequence[Trace], values: Sequence[F]) -> F:
    return np.concatenate([v[t.usable] for t, v in zip(traces, values, strict=True)])


def _rms(values: F) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
    surrogate = replace(
        physical.surrogate,
        dictionary=dictionary,
        weights=learnt.weights,
        cost_J=cost_on_left_out(examples, predicted),
    )
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
