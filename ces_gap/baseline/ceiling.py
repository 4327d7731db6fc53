"""The ceiling: how much of a gap the generic learner explains on blocks it did not see, time and heat included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import LearnerResult, learn
from ces_gap.trace import F, Trace


@dataclass(frozen=True)
class Ceiling:
    """What the generic learner makes of measured less modelled force."""

    dictionary: Dictionary
    learnt: LearnerResult

    def add_to(self, traces: Sequence[Trace], forces: Sequence[F]) -> list[F]:
        """Return forces [N] (n,) modelled on some traces with what was learnt added."""
        return [
            f + self.dictionary.features(t, t.inputs, f) @ self.learnt.weights
            for t, f in zip(traces, forces, strict=True)
        ]


def learn_ceiling(traces: Sequence[Trace], forces: Sequence[F]) -> Ceiling:
    """Return what the learner makes of measured less modelled force [N] on some traces."""
    dictionary = Dictionary(Scales.of(traces, forces), by_time=True)
    features = [dictionary.features(t, t.inputs, f) for t, f in zip(traces, forces, strict=True)]
    targets = [t.force - f for t, f in zip(traces, forces, strict=True)]
    return Ceiling(dictionary, learn(features, targets, [t.usable for t in traces], traces[0].rate_Hz))
