"""The ceiling: how much of a gap the generic learner explains on blocks it did not see, time and heat included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.dictionary import Dictionary, Scales
from ces_gap.baseline.learner import Learnt, learn
from ces_gap.trace import Trace

F = NDArray[np.float64]


def ceiling_dictionary(traces: Sequence[Trace], forces: Sequence[F]) -> Dictionary:
    """Return the dictionary of the ceiling for traces and the force [N] modelled on each."""
    return Dictionary(Scales.of(traces, forces), by_time=True)


def learn_ceiling(traces: Sequence[Trace], forces: Sequence[F]) -> tuple[Dictionary, Learnt]:
    """Return what the learner makes of measured minus modelled force [N] on some traces."""
    dictionary = ceiling_dictionary(traces, forces)
    features = [dictionary.features(t, t.inputs, f) for t, f in zip(traces, forces, strict=True)]
    targets = [t.force - f for t, f in zip(traces, forces, strict=True)]
    return dictionary, learn(features, targets, [t.usable for t in traces], traces[0].rate_Hz)
