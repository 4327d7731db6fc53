"""The ceiling: the share of a gap that the generic learner explains on held-out blocks, from time and heat as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import LearnerResult, learn
from ces_gap.trace import F, Trace


@dataclass(frozen=True)
class Ceiling:
    """The generic learner, fitted to measured minus modelled force."""

    dictionary: Dictionary
    learnt: LearnerResult

    def add_to(self, traces: Sequence[Trace], forces: Sequence[F]) -> list[F]:
        """Return the modelled forces [N] (n,) of the traces plus the learner's prediction."""
        return [
            f + self.dictionary.features(t, t.inputs, f) @ self.learnt.weights
            for t, f in zip(traces, forces, strict=True)
        ]


def learn_ceiling(traces: Sequence[Trace], forces: Sequence[F]) -> Ceiling:
    """Fit the learner to measured minus modelled force [N] on the traces."""
    dictionary = Dictionary(Scales.of(traces, forces), by_time=True)
    features = [dictionary.features(t, t.inputs, f) for t, f in zip(traces, forces, strict=True)]
    targets = [t.force - f for t, f in zip(traces, forces, strict=True)]
    return Ceiling(dictionary, learn(features, targets, [t.usable for t in traces], traces[0].rate_Hz))
