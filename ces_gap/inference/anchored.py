"""A slow simulation asked seldom: a cheap stand-in, set right where the simulation itself was run.

What the stand-in lacks at the anchor is added in proportion to how far the inputs were moved along the anchor's change,
which is exact at the anchor and to first order along the line from the recorded inputs to it (space mapping; Bandler
et al. 1994).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Plant, Rerun
from ces_gap.effects.effect import Effect
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import Fit, polish
from ces_gap.trace import Inputs, Trace

F = NDArray[np.float64]

ROUNDS = 2
SETTLED = 0.01  # relative change of the parameters from which another round is not worth a simulation


@dataclass(frozen=True)
class Anchored:
    """The stand-in `cheap`; by a trace's id, the anchor's `change` of inputs (2n,) and what is `lacking` [N] (n,)."""

    cheap: Rerun
    change: Mapping[int, F]
    lacking: Mapping[int, F]

    def force(self, trace: Trace, inputs: Inputs) -> F:
        """Return the simulated force [N] (n,)."""
        if inputs is trace.inputs:
            return trace.simulated
        anchor = self.change[id(trace)]
        size = float(anchor @ anchor)
        share = float(anchor @ _change(trace, inputs)) / size if size > 0.0 else 0.0
        return self.cheap.force(trace, inputs) + min(max(share, -1.0), 3.0) * self.lacking[id(trace)]


def _change(trace: Trace, inputs: Inputs) -> F:
    """Return by how much inputs differ from the recorded ones (2n,), each over its spread."""
    pairs = ((inputs.position, trace.inputs.position), (inputs.current, trace.inputs.current))
    return np.concatenate([(new - old) / max(float(old.std()), 1e-9) for new, old in pairs])


def anchor(evidence: Evidence, fit: Fit, exact: Rerun, cheap: Rerun) -> Evidence:
    """Return the evidence with the simulation itself run at the fit."""
    change: dict[int, F] = {}
    lacking: dict[int, F] = {}
    for trace, alone in zip(evidence.traces, evidence.alone, strict=True):
        inputs = fit.composition.drive(trace, alone)
        change[id(trace)] = _change(trace, inputs)
        lacking[id(trace)] = exact.force(trace, inputs) - cheap.force(trace, inputs)
    return replace(evidence, plant=Plant(Anchored(cheap, change, lacking), evidence.plant.correction))


def polished(evidence: Evidence, fit: Fit, exact: Rerun, cheap: Rerun, rounds: int = ROUNDS) -> Fit:
    """Return the fit redone with the simulation itself run once a round where it stood."""
    if not reruns(fit.effects):
        return fit
    for _ in range(rounds):
        before = fit.searched
        fit = polish(anchor(evidence, fit, exact, cheap), fit.effects, fit.searched)
        if np.abs(fit.searched - before).max() <= SETTLED * np.abs(before).max():
            break
    return fit


def reruns(effects: Sequence[Effect]) -> bool:
    """True if one of the effects changes what drives the simulation."""
    return any(effect.reruns for effect in effects)
