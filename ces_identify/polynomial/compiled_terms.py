"""Polynomials over whole arrays: constructed inputs, and terms as the arrays that the kernels read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import kernels
from ces_identify.numerics.core import compiled, core_kernel
from ces_identify.numerics.kernels import TermArrays
from ces_observer.flat import Layout
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import BASE, ConstructedInput, TriangularMembership, lay_out_constructed
from ces_observer.structures.structure import Range
from ces_observer.structures.terms import Factor, Term, collect_constructed
from ces_observer.tick.constructed import constructed_update, membership
from ces_observer.tick.model import clamp

Power = tuple[str, float, bool]  # signal, power, signed


clamp_value, update_inputs, membership_value = compiled(clamp), compiled(constructed_update), compiled(membership)


def signal_values(
    constructed: Sequence[ConstructedInput], envelope: Envelope, inputs: Sequence[F] | F, segments: I, rate_Hz: float
) -> dict[str, F]:
    """Return position, speed and current (ticks,), clamped, and each constructed input as the observer computes it.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A]; they are clamped to `envelope`. In `constructed`,
    each follows those from which it is computed; outside `segments` they are zero.
    """
    layout = Layout(0, 0, len(BASE), 0)
    table, places = lay_out_constructed(layout, constructed, rate_Hz, 0)
    arrays = layout.arrays()
    p, n, s = np.array(arrays.p), np.array(arrays.n, np.int64), np.array(arrays.s)
    values = np.zeros((len(places), len(inputs[0])))
    values[: len(BASE)] = inputs
    _construct(p, n, s, table, np.array([envelope.by_signal[name] for name in BASE]), segments, values)
    return dict(zip(places, values, strict=True))


@core_kernel
def _construct(p: F, n: I, s: F, table: int, ranges: F, segments: I, values: F) -> None:
    """Clamp position, speed and current, the first rows of `values` (signals, ticks), and compute the other rows."""
    count = len(values) - 3
    for row in range(3):
        for i in range(values.shape[1]):
            values[row, i] = clamp_value(values[row, i], ranges[row, 0], ranges[row, 1])
    if count == 0:
        return
    for segment in range(len(segments)):
        for i in range(segments[segment, 0], segments[segment, 1]):
            for row in range(3):
                s[row] = values[row, i]
            update_inputs(p, n, s, table, count, 0, i > segments[segment, 0])
            for row in range(3, 3 + count):
                values[row, i] = s[row]


@core_kernel
def _memberships(values: F, low: float, peak: float, high: float) -> F:
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = membership_value(values[i], low, peak, high)
    return out


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
        return _memberships(values, *hat.ends) if hat else np.asarray(kernels.power_row(values, power, signed))

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
