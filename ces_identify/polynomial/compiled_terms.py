"""Polynomials over whole arrays: constructed inputs, terms as the arrays that the kernels read, and the free run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.numerics import kernels
from ces_identify.numerics.kernels import TermArrays
from ces_identify.polynomial import constructed_kernels
from ces_observer.model import Envelope, Model
from ces_observer.structures.constructed_inputs import ConstructedInput, Frequency, Lag, TriangularMembership
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.structure import Range
from ces_observer.structures.terms import Factor, Term, collect_constructed

SIGNALS = ("position", "speed", "current")
Power = tuple[str, float, bool]  # signal, power, signed


def signal_values(
    constructed: Sequence[ConstructedInput], envelope: Envelope, inputs: Sequence[F] | F, segments: I, rate_Hz: float
) -> dict[str, F]:
    """Return position, speed and current (ticks,), clamped, and each constructed input as the observer computes it.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A]; they are clamped to `envelope`. In `constructed`,
    each follows those from which it is computed.
    """
    ranges = envelope.by_signal
    known = {signal: np.clip(values, *ranges[signal]) for signal, values in zip(SIGNALS, inputs, strict=True)}
    for one in constructed:
        known[one.name] = _constructed_value(one, known, segments, rate_Hz)
    return known


def _constructed_value(one: ConstructedInput, known: Mapping[str, F], segments: I, rate_Hz: float) -> F:
    if isinstance(one, TriangularMembership):
        return membership(one, known[one.of])
    if isinstance(one, Frequency):
        settings = (one.gain(rate_Hz), one.floor_m, *one.range_Hz)
        return np.asarray(constructed_kernels.frequency(known["position"], known["speed"], segments, *settings))
    if isinstance(one, Lag):
        return np.asarray(constructed_kernels.lag(known[one.of], segments, one.gain(rate_Hz)))
    hysteresis = constructed_kernels.stop if one.kind == "stop" else constructed_kernels.play
    return np.asarray(hysteresis(known[one.of], segments, one.half_width))


def membership(definition: TriangularMembership, values: F) -> F:
    """Return the membership (n,) of `values` (n,)."""
    low = 1.0 if definition.low is None else 1.0 - (values - definition.peak) / (definition.low - definition.peak)
    high = 1.0 if definition.high is None else 1.0 - (values - definition.peak) / (definition.high - definition.peak)
    return np.maximum(0.0, np.where(values < definition.peak, low, high))


@dataclass(frozen=True)
class CompiledTerms:
    """Terms as arrays, the powers in the table that they index, and the constructed inputs that they use."""

    powers: tuple[Power, ...]
    arrays: TermArrays
    constructed: tuple[ConstructedInput, ...] = ()

    def subset(self, chosen: I) -> TermArrays:
        """Return the arrays of the terms at the indices `chosen`."""
        return TermArrays(*(array[chosen] for array in self.arrays))

    def power_table(self, envelope: Envelope, inputs: Sequence[F] | F, segments: I, rate_Hz: float) -> F:
        """Return each power of its signal, shape (max(1, powers), ticks); for the inputs see `signal_values`."""
        values = signal_values(self.constructed, envelope, inputs, segments, rate_Hz)
        table = np.zeros((max(1, len(self.powers)), len(inputs[0])))
        for i, (signal, power, signed) in enumerate(self.powers):
            table[i] = kernels.power_row(values[signal], power, signed)
        return table

    def variable(self, term: int, factor: int) -> tuple[str, int]:
        """Return the signal and lag of which a factor is a function; for a membership, the signal behind it."""
        signal = self.powers[self.arrays.columns[term, factor]][0]
        hat = self._memberships.get(signal)
        return (hat.of if hat else signal), int(self.arrays.lags[term, factor])

    def factor_values(self, column: int, values: F) -> F:
        """Return row `column` of the power table at `values` (n,) of the factor's variable."""
        signal, power, signed = self.powers[column]
        hat = self._memberships.get(signal)
        return membership(hat, values) if hat else np.asarray(kernels.power_row(values, power, signed))

    def ranges(self, envelope: Envelope) -> dict[str, Range]:
        """Return the range of every signal, constructed ones included."""
        ranges = dict(envelope.by_signal)
        return ranges | {one.name: one.range(ranges) for one in self.constructed}

    def kinks(self, signal: str) -> list[float]:
        """Return the values at which the memberships of a signal change slope, ascending."""
        return sorted({at for hat in self._memberships.values() if hat.of == signal for at in hat.kinks})

    @property
    def _memberships(self) -> dict[str, TriangularMembership]:
        return {one.name: one for one in self.constructed if isinstance(one, TriangularMembership)}


def compile_terms(terms: Sequence[Term]) -> CompiledTerms:
    """Return the arrays of `terms`, without their coefficients."""
    powers = sorted({_power(f) for term in terms for f in term.inputs})
    row = {power: i for i, power in enumerate(powers)}
    counts = np.array([len(term.inputs) for term in terms], np.int64)
    columns, lags = np.zeros((2, len(terms), int(counts.max(initial=1))), np.int64)
    for t, term in enumerate(terms):
        for f, factor in enumerate(term.inputs):
            columns[t, f], lags[t, f] = row[_power(factor)], factor.lag
    outputs = np.array([term.output_lag for term in terms], np.int64)
    return CompiledTerms(tuple(powers), TermArrays(columns, lags, counts, outputs), collect_constructed(terms))


def _power(factor: Factor) -> Power:
    return factor.signal, float(factor.power), factor.signed


def run_polynomial(polynomial: Polynomial, model: Model, inputs: F, segments: I) -> tuple[F, Mask]:
    """Return the batch run of a polynomial, as `StructureKit.batch_run` describes it."""
    terms = compile_terms(polynomial.terms)
    powers = terms.power_table(model.envelope, inputs, segments, model.sampling.rate_Hz)
    coefficients = np.array([term.coefficient for term in polynomial.terms])
    force, held = kernels.free_run(powers, segments, terms.arrays, coefficients, model.force_envelope_N)
    return np.asarray(force), np.asarray(held)
