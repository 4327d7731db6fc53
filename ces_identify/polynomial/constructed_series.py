"""Constructed inputs of whole series: definitions and uniform inputs in, one array per constructed input out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.polynomial import constructed_kernels as kernels
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Frequency,
    Lag,
    TriangularMembership,
)


def constructed_values(
    constructed: Sequence[ConstructedInput],
    envelope: Envelope,
    inputs: Sequence[F],
    segments: I,
    rate_Hz: float,
) -> dict[str, F]:
    """Return each constructed input (ticks,) by name, as the observer's `InputConstructor` computes it.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A]; they are clamped to `envelope`. In `constructed`,
    each follows those from which it is computed.
    """
    ranges = envelope.by_signal
    known = {s: np.clip(values, *ranges[s]) for s, values in zip(("position", "speed", "current"), inputs, strict=True)}
    for one in constructed:
        known[one.name] = _values(one, known, segments, rate_Hz)
    return {one.name: known[one.name] for one in constructed}


def membership(definition: TriangularMembership, values: F) -> F:
    """Return the membership (n,) of `values` (n,)."""
    low = 1.0 if definition.low is None else 1.0 - (values - definition.peak) / (definition.low - definition.peak)
    high = 1.0 if definition.high is None else 1.0 - (values - definition.peak) / (definition.high - definition.peak)
    return np.maximum(0.0, np.where(values < definition.peak, low, high))


def _values(one: ConstructedInput, known: Mapping[str, F], segments: I, rate_Hz: float) -> F:
    if isinstance(one, TriangularMembership):
        return membership(one, known[one.of])
    if isinstance(one, Frequency):
        settings = (one.gain(rate_Hz), one.floor_m, *one.range_Hz)
        return np.asarray(kernels.frequency(known["position"], known["speed"], segments, *settings))
    if isinstance(one, Lag):
        return np.asarray(kernels.lag(known[one.of], segments, one.gain(rate_Hz)))
    hysteresis = kernels.stop if one.kind == "stop" else kernels.play
    return np.asarray(hysteresis(known[one.of], segments, one.half_width))
