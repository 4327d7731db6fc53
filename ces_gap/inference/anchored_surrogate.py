"""A slow simulation asked seldom: a cheap stand-in, set right where the simulation itself was run.

What the stand-in lacks at the anchor is added in proportion to how far the inputs were moved along the anchor's change,
which is exact at the anchor and to first order along the line from the recorded inputs to it (space mapping; Bandler
et al. 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import TraceSimulator
from ces_gap.effects.effect import Effect
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, polish
from ces_gap.trace import Trace, TraceInputs

F = NDArray[np.float64]

ROUNDS = 2
SETTLED = 0.01  # relative change of the parameters from which another round is not worth a simulation


@dataclass(frozen=True)
class AnchoredSurrogate(TraceSimulator):
    """The surrogate `cheap` on one trace; the anchor's `change` of inputs (2n,), what is `lacking` [N] (n,) there."""

    cheap: TraceSimulator
    change: F
    lacking: F

    def force(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return the simulated force [N] (n,)."""
        size = float(self.change @ self.change)
        share = float(self.change @ _change(trace, inputs)) / size if size > 0.0 else 0.0
        return self.cheap.force(trace, inputs) + min(max(share, -1.0), 3.0) * self.lacking


def _change(trace: Trace, inputs: TraceInputs) -> F:
    """Return by how much inputs differ from the recorded ones (2n,), each over its spread."""
    pairs = ((inputs.position, trace.inputs.position), (inputs.current, trace.inputs.current))
    return np.concatenate([(new - old) / max(float(old.std()), 1e-9) for new, old in pairs])


@dataclass(frozen=True)
class Refinement:
    """How fits are redone with the simulation itself, `exact`, where the evidence holds a surrogate for it.

    Without `exact`, the evidence holds the simulation itself or nothing better is to be had, and all stays as it is.
    """

    exact: TraceSimulator | None = None

    def refine(self, evidence: Evidence, fit: EffectFit) -> EffectFit:
        """Return the fit redone with the simulation itself run where it stood."""
        return fit if self.exact is None else refine_fit(evidence, fit, self.exact)

    def anchor(self, evidence: Evidence, fit: EffectFit) -> Evidence:
        """Return evidence whose surrogate is right around the fit."""
        return (
            evidence
            if self.exact is None or not needs_rerun(fit.effects)
            else anchor_evidence(evidence, fit, self.exact)
        )


def anchor_evidence(evidence: Evidence, fit: EffectFit, exact: TraceSimulator) -> Evidence:
    """Return the evidence, whose plants hold a surrogate, with the simulation itself run at the fit."""
    plants = []
    for plant, trace, alone in zip(evidence.plants, evidence.traces, evidence.alone, strict=True):
        inputs = fit.composition.drive(trace, alone)
        lacking = exact.force(trace, inputs) - plant.simulation.force(trace, inputs)
        plants.append(replace(plant, simulation=AnchoredSurrogate(plant.simulation, _change(trace, inputs), lacking)))
    return replace(evidence, plants=tuple(plants))


def refine_fit(evidence: Evidence, fit: EffectFit, exact: TraceSimulator, rounds: int = ROUNDS) -> EffectFit:
    """Return the fit redone with the simulation itself run once a round where it stood."""
    if not needs_rerun(fit.effects):
        return fit
    for _ in range(rounds):
        before = fit.searched
        fit = polish(anchor_evidence(evidence, fit, exact), fit.effects, fit.searched)
        if np.abs(fit.searched - before).max() <= SETTLED * np.abs(before).max():
            break
    return fit


def needs_rerun(effects: Sequence[Effect]) -> bool:
    """True if one of the effects changes what drives the simulation."""
    return any(effect.reruns for effect in effects)
