"""The baseline's own error, learnt from reference recordings that are known to be free of the effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import Learnt, learn
from ces_gap.trace import Inputs, Trace

F = NDArray[np.float64]


@dataclass(frozen=True)
class LearntCorrection:
    """Weights (q,) of the dictionary's features."""

    dictionary: Dictionary
    weights: F

    def force(self, trace: Trace, inputs: Inputs, simulated: F) -> F:
        """Return what to add to the simulated force [N] (n,)."""
        return self.dictionary.told(trace, inputs, simulated, self.weights)

    def as_json(self) -> dict[str, Any]:
        """Return the correction as plain values."""
        return {"dictionary": self.dictionary.as_json(), "weights": self.weights.tolist()}

    @classmethod
    def from_json(cls, given: dict[str, Any]) -> LearntCorrection:
        """Return the correction that `as_json` wrote; raises KeyError, TypeError or ValueError for others."""
        return cls(Dictionary.from_json(given["dictionary"]), np.array(given["weights"], dtype=np.float64))


def learn_correction(references: Sequence[Trace]) -> tuple[LearntCorrection, Learnt]:
    """Return the correction that the references teach, and all that was learnt with it."""
    dictionary = Dictionary(Scales.of(references, [t.simulated for t in references]))
    features = [dictionary.features(t, t.inputs, t.simulated) for t in references]
    learnt = learn(
        features, [t.force - t.simulated for t in references], [t.usable for t in references], references[0].rate_Hz
    )
    return LearntCorrection(dictionary, learnt.weights), learnt
