"""The terms of a model, typeset, with the contribution of each to the force and the meaning of their symbols."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.numerics import kernels
from ces_identify.polynomial.compiled_terms import compile_terms
from ces_identify.polynomial.problem import pieces
from ces_identify.prepare.series import SimulatedSeries
from ces_observer.model import Envelope, Model
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
)
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.structure import Range
from ces_observer.structures.terms import Factor, Term
from ces_report.typesetting import (
    UNITS,
    ModelTable,
    Symbols,
    TableColumn,
    describe_signals,
    minus,
    signal_symbol,
    three_figures,
)

SIGN = (Markup("sgn"), "sign: \N{MINUS SIGN}1, 0 or 1")


def describe_symbols(terms: Iterable[Term], rate_Hz: float) -> Symbols:
    """Return the symbols that appear in `terms` with their meanings; the logged signals and the tick come first."""
    factors = [factor for term in terms for factor in term.factors]
    logged = describe_signals(("force", *(f.signal for f in factors if f.definition is None)), rate_Hz)
    definitions = (one for f in factors for one in (getattr(f.definition, "base", None), f.definition))
    constructed = {one.name: one for one in definitions if one is not None}
    symbols = [(Markup("<var>{}</var>").format(name), describe_input(one)) for name, one in constructed.items()]
    signed = any(f.signed and f.signal != "force" and f.power % 2 != 1.0 for f in factors)
    return (*logged, *symbols, *([SIGN] if signed else []))


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


NOTE = (
    "RMS of each term along the free run over the {} recordings, and its ratio to the RMS of the simulated force; "
    "terms may cancel, so the shares need not add up to 100\N{NO-BREAK SPACE}%."
)
NO_RUN = "–: no simulated force to compare a term with, since no recording was run or every run diverged at once."
COLUMNS = (
    TableColumn(Markup("Regressor"), "", "formula"),
    TableColumn(Markup("Coefficient")),
    TableColumn(Markup("Unit"), "", "unit"),
    TableColumn(Markup("RMS [N]")),
    TableColumn(Markup("Of the force [%]"), "j", "j"),
)


def term_table(polynomial: Polynomial, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the terms by their contribution to the free runs, largest first; `role` names the recordings' role."""
    parts, whole = contributions(polynomial, model, runs)
    order = np.argsort(-parts, kind="stable") if whole > 0.0 else np.arange(len(parts))
    bar = Markup('<span class="figure">{}</span><span class="track"><span class="bar" style="width:{}%"></span></span>')
    rows = []
    for t in order:
        term, cells = polynomial.terms[t], (Markup("\N{EN DASH}"), Markup("\N{EN DASH}"))
        if whole > 0.0:
            part, share = float(parts[t]), 100.0 * float(parts[t]) / whole
            cells = Markup(three_figures(part)), bar.format(three_figures(share), f"{min(share, 100.0):.1f}")
        coefficient = Markup(minus(f"{term.coefficient:.5g}"))
        rows.append((format_term(term, model.envelope), coefficient, coefficient_unit(term), *cells))
    equation = Markup("<var>F</var>(<var>k</var>) = Σ coefficient · regressor")
    symbols = describe_symbols(polynomial.terms, model.sampling.rate_Hz)
    after = NOTE.format(role) if whole > 0.0 else NO_RUN
    return ModelTable("terms", "Regressors", equation, COLUMNS, tuple(rows), note_after=after, symbols=symbols)


def contributions(polynomial: Polynomial, model: Model, runs: Sequence[SimulatedSeries]) -> tuple[F, float]:
    """Return the RMS of each term (terms,) [N] and of the simulated force [N] over all scored, finite ticks."""
    squares, total, count = np.zeros(len(polynomial.terms)), 0.0, 0
    for one in runs:
        scored = one.series.scored & np.isfinite(one.run.force)
        for start, values in term_forces(polynomial, model, one):
            mask = scored[start : start + values.shape[1]]
            squares += (values[:, mask] ** 2).sum(axis=1)
        total += float((one.run.force[scored] ** 2).sum())
        count += int(scored.sum())
    return np.sqrt(squares / max(count, 1)), float(np.sqrt(total / max(count, 1)))


def term_forces(polynomial: Polynomial, model: Model, one: SimulatedSeries) -> list[tuple[int, F]]:
    """Return each term's force [N] along the free run, which they add up to: pieces of first tick, (terms, ticks)."""
    series, run = one.series, one.run
    inputs = np.stack([series.position, series.speed, series.current])
    terms = compile_terms(polynomial.terms)
    powers = terms.power_table(model.envelope, inputs, series.segments, model.sampling.rate_Hz)
    gain = np.array([term.coefficient for term in polynomial.terms])[:, None]
    forces = []
    for s, k0, k1 in pieces(series.segments):
        columns = kernels.regressor_columns(powers, run.force, series.segments, terms.arrays, k0, k1, s)
        forces.append((int(k0), gain * columns))
    return forces


def format_term(term: Term, envelope: Envelope) -> Markup:
    """Return the product of the term's factors in HTML, inputs first, without bars around nonnegative signals."""
    outputs = (f for f in term.factors if f.signal == "force")
    factors = [_factor(f, envelope.by_signal) for f in (*term.inputs, *outputs)]
    return Markup(" · ").join(factors) if factors else Markup("1")


def _factor(f: Factor, ranges: Mapping[str, Range]) -> Markup:
    s = signal_symbol(f.signal, f.lag)
    if f.signal == "force":
        return s
    if f.power == 0.0:
        return Markup("sgn {}").format(s) if f.signed else Markup("1")
    low = f.definition.range(ranges)[0] if f.definition is not None else ranges[f.signal][0]
    if low >= 0.0 or f.power % 2 == (1.0 if f.signed else 0.0):
        return _format_power(s, f.power)
    size = _format_power(Markup("|{}|").format(s), f.power)
    return Markup("sgn {} · {}").format(s, size) if f.signed else size


def _format_power(base: Markup, power: float) -> Markup:
    return base if power == 1.0 else Markup("{}<sup>{}</sup>").format(base, f"{power:g}")


def coefficient_unit(term: Term) -> Markup:
    """Return the unit of the term's coefficient: newtons per unit of its factors."""
    powers: dict[str, float] = {}
    for f in term.inputs:
        if unit := _unit(f):
            powers[unit] = powers.get(unit, 0.0) - f.power
    units = [Markup("N")] if not term.output_lag else []
    for unit, power in powers.items():
        if power:
            base = f"({unit})" if "/" in unit else unit
            units.append(Markup("{}<sup>{}</sup>").format(base, minus(f"{power:g}")))
    return Markup("\N{NO-BREAK SPACE}").join(units) if units else Markup("1")


def _unit(f: Factor) -> str:
    """Return the unit of the factor's signal; a membership has none."""
    if f.definition is None:
        return UNITS[f.signal]
    if isinstance(f.definition, TriangularMembership):
        return ""
    return UNITS[f.definition.of if isinstance(f.definition, Hysteresis | Lag) else "frequency"]
