"""Terms as the arrays the kernels read, and the power tables they read them from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_identify import kernels
from ces_observer.model import Envelope, Factor, Term

SIGNALS = ("position", "speed", "current")
Power = tuple[str, float, bool]  # signal, power, signed


@dataclass(frozen=True)
class CompiledTerms:
    """Terms as arrays: `columns`, `lags` (terms, most factors), `counts`, `outputs` (terms,); see kernels.py."""

    powers: tuple[Power, ...]
    columns: NDArray[np.int64]
    lags: NDArray[np.int64]
    counts: NDArray[np.int64]
    outputs: NDArray[np.int64]

    @property
    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Columns, lags, counts and outputs, in the order every kernel takes them."""
        return self.columns, self.lags, self.counts, self.outputs

    def subset(self, chosen: NDArray[np.int64]) -> CompiledTerms:
        """Return the terms at the indices `chosen`, reading the same power table."""
        return replace(
            self,
            columns=self.columns[chosen],
            lags=self.lags[chosen],
            counts=self.counts[chosen],
            outputs=self.outputs[chosen],
        )


def compile_terms(terms: Sequence[Term]) -> CompiledTerms:
    """Return the arrays of `terms`; their coefficients are left to the caller."""
    powers = sorted({_power(f) for term in terms for f in term.inputs})
    row = {power: i for i, power in enumerate(powers)}
    width = max([len(term.inputs) for term in terms] + [1])
    columns = np.zeros((len(terms), width), np.int64)
    lags = np.zeros((len(terms), width), np.int64)
    for t, term in enumerate(terms):
        for f, factor in enumerate(term.inputs):
            columns[t, f], lags[t, f] = row[_power(factor)], factor.lag
    counts = np.array([len(term.inputs) for term in terms], np.int64)
    outputs = np.array([term.output_lag for term in terms], np.int64)
    return CompiledTerms(tuple(powers), columns, lags, counts, outputs)


def power_table(
    powers: Sequence[Power],
    envelope: Envelope,
    position: NDArray[np.float64],
    speed: NDArray[np.float64],
    current: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return each power of its signal, clamped to the envelope; shape (max(1, powers), ticks)."""
    clamped = {
        "position": np.clip(position, *envelope.position_m),
        "speed": np.clip(speed, *envelope.speed_m_s),
        "current": np.clip(current, *envelope.current_A),
    }
    table = np.zeros((max(1, len(powers)), len(position)))
    for i, (signal, power, signed) in enumerate(powers):
        table[i] = kernels.power_row(clamped[signal], power, signed)
    return table


def _power(factor: Factor) -> Power:
    return factor.signal, float(factor.power), factor.signed
