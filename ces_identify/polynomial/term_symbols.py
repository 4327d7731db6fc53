"""The symbols in the terms of a model and their meanings, constructed inputs included."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from markupsafe import Markup

from ces_identify.typesetting import UNITS, Symbols, describe_signals
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
)
from ces_observer.structures.terms import Factor, Term

SIGN = (Markup("sgn"), "sign: \N{MINUS SIGN}1, 0 or 1")


def describe_symbols(terms: Iterable[Term], rate_Hz: float) -> Symbols:
    """Return the symbols that appear in `terms` with their meanings; the logged signals and the tick come first."""
    factors = [factor for term in terms for factor in term.factors]
    logged = describe_signals(("force", *(f.signal for f in factors if f.definition is None)), rate_Hz)
    constructed = {one.name: one for f in factors for one in _definitions(f)}
    symbols = [(Markup("<var>{}</var>").format(name), describe_input(one)) for name, one in constructed.items()]
    return (*logged, *symbols, *([SIGN] if any(map(_has_sign, factors)) else []))


def describe_input(one: ConstructedInput) -> str:
    """Return how a constructed input is computed, in words with its numbers."""
    if isinstance(one, Frequency):
        low, high = one.range_Hz
        return f"frequency of the motion over the last {one.time_constant_s:g} s, within {low:g} to {high:g} Hz"
    if isinstance(one, Lag):
        return f"{one.of} behind a first-order lag of {1e3 * one.time_constant_s:g} ms [{UNITS[one.of]}]"
    if isinstance(one, Hysteresis):
        width = f"\N{PLUS-MINUS SIGN}{one.half_width:g} {UNITS[one.of]}"
        if one.kind == "stop":
            return f"change of the {one.of} since its last reversal, limited to {width}"
        return f"{one.of} with a play of {width}: it stands still after a reversal until the play is used up"
    ends = [f"{end:g}" for end in (one.low, one.high) if end is not None]
    return f"membership of {one.of}: 1 at {one.peak:g}, falling to 0 at {' and '.join(ends)}"


def _definitions(factor: Factor) -> Iterator[ConstructedInput]:
    """Yield the definition of a factor's signal, and before it the one that it is computed from."""
    if factor.definition is not None:
        if isinstance(factor.definition, TriangularMembership) and factor.definition.base is not None:
            yield factor.definition.base
        yield factor.definition


def _has_sign(factor: Factor) -> bool:
    """Return whether a factor is typeset with the sign function."""
    return factor.signed and factor.signal != "force" and factor.power % 2 != 1.0
