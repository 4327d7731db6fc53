"""The baseline error of the simulation, learnt from reference recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import LearnerResult, learn
from ces_gap.trace import F, Trace, TraceInputs


@dataclass(frozen=True)
class LearnedCorrection:
    """A correction of the simulated force: weights (q,) of the features of `dictionary`."""

    dictionary: Dictionary
    weights: F

    def force(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        """Return the force [N] (n,) to be added to the simulated one."""
        return self.dictionary.predict(trace, inputs, simulated, self.weights)

    def as_json(self) -> dict[str, Any]:
        """Return the correction as plain values."""
        return {"dictionary": self.dictionary.as_json(), "weights": self.weights.tolist()}

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> LearnedCorrection:
        """Return the correction from `as_json`; raises KeyError, TypeError or ValueError if the document is not one."""
        dictionary = Dictionary.from_json(document["dictionary"])
        weights = np.array(document["weights"], dtype=np.float64)
        dictionary.require_weights(weights)
        return cls(dictionary, weights)


def learn_correction(references: Sequence[Trace]) -> tuple[LearnedCorrection, LearnerResult]:
    """Return the correction learnt from the references, and the full result of the learner."""
    dictionary = Dictionary(Scales.of(references, [t.simulated for t in references]))
    features = [dictionary.features(t, t.inputs, t.simulated) for t in references]
    learnt = learn(
        features, [t.force - t.simulated for t in references], [t.usable for t in references], references[0].rate_Hz
    )
    return LearnedCorrection(dictionary, learnt.weights), learnt
