"""Fits repeated with the simulation itself where its twin replaces it in the search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ces_data.arrays import F
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_from
from ces_gap.trace import Trace, TraceInputs
from ces_observer.errors import CesError

ROUNDS = 2
MIN_CHANGE = 0.01  # relative change of the parameters below which another round is not worth a simulation


@dataclass(frozen=True)
class AnchoredTwin(TraceSimulator):
    """The twin `cheap` on one trace, with the inputs (2n,) `moved` by the anchor and its `error` [N] (n,)."""

    cheap: TraceSimulator
    moved: F
    error: F

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,)."""
        size = float(self.moved @ self.moved)
        share = float(self.moved @ _change(trace, inputs)) / size if size > 0.0 else 0.0
        return self.cheap.force(trace, inputs) + min(max(share, -1.0), 3.0) * self.error


def _change(trace: Trace, inputs: TraceInputs) -> F:
    """Return how far inputs differ from the recorded ones (2n,), in units of their standard deviations."""
    pairs = ((inputs.position, trace.inputs.position), (inputs.current, trace.inputs.current))
    return np.concatenate([(new - old) / max(float(old.std()), 1e-9) for new, old in pairs])


@dataclass(frozen=True)
class Refinement:
    """Repeats fits with the `exact` simulation where the evidence holds its twin; does nothing if it is None."""

    exact: TraceSimulator | None = None

    def refine(self, evidence: Evidence, fit: EffectFit) -> EffectFit:
        """Return the refined fit; each round runs the simulation once on every trace."""
        if self.exact is None or not fit.composition.reruns:
            return fit
        for _ in range(ROUNDS):
            before = fit.searched
            fit = fit_from(self.anchor(evidence, fit), fit.effects, before)
            if np.abs(fit.searched - before).max() <= MIN_CHANGE * np.abs(before).max():
                break
        return fit

    def anchor(self, evidence: Evidence, fit: EffectFit) -> Evidence:
        """Return the evidence with twins that are exact at the fit, as far as the simulation takes its inputs."""
        if self.exact is None or not fit.composition.reruns:
            return evidence
        plants = []
        for plant, trace, alone in zip(evidence.plants, evidence.traces, evidence.alone, strict=True):
            inputs = fit.composition.drive(trace, alone)
            try:
                error = self.exact.force(trace, inputs) - plant.simulation.force(trace, inputs)
            except CesError:
                return evidence
            plants.append(replace(plant, simulation=AnchoredTwin(plant.simulation, _change(trace, inputs), error)))
        return replace(evidence, plants=tuple(plants))
