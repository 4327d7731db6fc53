"""Few runs of a slow simulation: a fast surrogate that is exact at an anchor, where the simulation itself was run.

The surrogate's error at the anchor is added in proportion to how far the inputs moved along the anchor's change. The
sum is exact at the anchor, and to first order along the line from the recorded inputs to it (space mapping; Bandler
et al. 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.baseline.plant import TraceSimulator
from ces_gap.effects.effect import Effect
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_from
from ces_gap.trace import F, Trace, TraceInputs

ROUNDS = 2
MIN_CHANGE = 0.01  # relative change of the parameters below which another round is not worth a simulation


@dataclass(frozen=True)
class AnchoredSurrogate(TraceSimulator):
    """The surrogate `cheap` on one trace, with the anchor's `change` of inputs (2n,) and its `error` [N] (n,) there."""

    cheap: TraceSimulator
    change: F
    error: F

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,)."""
        size = float(self.change @ self.change)
        share = float(self.change @ _change(trace, inputs)) / size if size > 0.0 else 0.0
        return self.cheap.force(trace, inputs) + min(max(share, -1.0), 3.0) * self.error


def _change(trace: Trace, inputs: TraceInputs) -> F:
    """Return how far inputs differ from the recorded ones (2n,), in units of their standard deviations."""
    pairs = ((inputs.position, trace.inputs.position), (inputs.current, trace.inputs.current))
    return np.concatenate([(new - old) / max(float(old.std()), 1e-9) for new, old in pairs])


@dataclass(frozen=True)
class Refinement:
    """Repeats fits with the `exact` simulation where the evidence holds a surrogate; does nothing if it is None."""

    exact: TraceSimulator | None = None

    def refine(self, evidence: Evidence, fit: EffectFit) -> EffectFit:
        """Return the refined fit; each round runs the simulation once on every trace."""
        if self.exact is None or not needs_rerun(fit.effects):
            return fit
        for _ in range(ROUNDS):
            before = fit.searched
            fit = fit_from(self.anchor(evidence, fit), fit.effects, before)
            if np.abs(fit.searched - before).max() <= MIN_CHANGE * np.abs(before).max():
                break
        return fit

    def anchor(self, evidence: Evidence, fit: EffectFit) -> Evidence:
        """Return the evidence with surrogates that are exact at the fit."""
        if self.exact is None or not needs_rerun(fit.effects):
            return evidence
        plants = []
        for plant, trace, alone in zip(evidence.plants, evidence.traces, evidence.alone, strict=True):
            inputs = fit.composition.drive(trace, alone)
            error = self.exact.force(trace, inputs) - plant.simulation.force(trace, inputs)
            plants.append(replace(plant, simulation=AnchoredSurrogate(plant.simulation, _change(trace, inputs), error)))
        return replace(evidence, plants=tuple(plants))


def needs_rerun(effects: Sequence[Effect]) -> bool:
    """True if one of the effects changes the simulation's inputs."""
    return any(effect.reruns for effect in effects)
