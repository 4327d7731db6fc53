"""The baseline error of the simulation, learnt from reference recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import LearnerResult, learn
from ces_gap.baseline.noise import noise_of
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
    """Return the correction learnt from the references, and the full result of the learner.

    Noise and covariance are those of errors on references that the simulation has not seen.
    """
    correction, learnt = _learn(references)
    if all(t.simulated_left_out is None for t in references):
        return correction, learnt
    return correction, _count_unseen_errors(references, learnt)


def _learn(references: Sequence[Trace]) -> tuple[LearnedCorrection, LearnerResult]:
    dictionary = Dictionary(Scales.of(references, [t.simulated for t in references]))
    features = [dictionary.features(t, t.inputs, t.simulated) for t in references]
    learnt = learn(
        features, [t.force - t.simulated for t in references], [t.usable for t in references], references[0].rate_Hz
    )
    return LearnedCorrection(dictionary, learnt.weights), learnt


def _count_unseen_errors(references: Sequence[Trace], learnt: LearnerResult) -> LearnerResult:
    """Return the result with the noise of references left out of every fit, if that is stronger.

    A simulation fitted to the references is closer to them than to other recordings, and so is its correction. The
    covariance grows with the variance of the noise.
    """
    noise = noise_of(_leave_out(references, learnt), [t.usable for t in references])
    if noise.rms_N <= learnt.noise.rms_N:
        return learnt
    growth = (noise.rms_N / learnt.noise.rms_N) ** 2
    return replace(learnt, noise=noise, covariance=learnt.covariance * growth)


def _leave_out(references: Sequence[Trace], learnt: LearnerResult) -> list[F]:
    """Return the errors [N] (n,) on each reference of simulation and correction fitted without it.

    Of a single reference, stretches are left out of the simulation's fit and blocks of that of the correction.
    """
    errors = []
    for k, trace in enumerate(references):
        force = trace.simulated if trace.simulated_left_out is None else trace.simulated_left_out
        others = [t for i, t in enumerate(references) if i != k]
        added = _learn(others)[0].force(trace, trace.inputs, force) if others else learnt.crossfitted[k]
        errors.append(trace.force - force - added)
    return errors
