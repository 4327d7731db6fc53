"""The terms of a model: typeset for people, and how much of the force each one makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ces_identify.numerics import kernels
from ces_identify.polynomial.compiled import compile_terms, power_table
from ces_identify.polynomial.constructed_series import constructed_values
from ces_identify.report.drawing import minus
from ces_identify.validation.evaluate import Evaluation
from ces_observer.model import Envelope, Factor, Model, Term
from ces_observer.structures.constructed import Hat, Hysteresis, Lag

F = NDArray[np.float64]

SYMBOLS = {"force": "F", "speed": "v", "current": "i", "position": "x"}
UNITS = {"speed": "m/s", "current": "A", "position": "m", "frequency": "Hz"}
CHUNK = 4096  # ticks of all regressors held in memory at a time


@dataclass(frozen=True)
class TermRow:
    """A term as a row of the table: its formula, coefficient, the coefficient's unit, RMS [N] and share [%]."""

    formula: Markup
    coefficient: str
    unit: Markup
    rms_N: float | None
    share: float | None


def term_rows(model: Model, evaluations: Sequence[Evaluation]) -> list[TermRow]:
    """Return the terms of `model` by what they contribute along the free runs of `evaluations`, most first."""
    parts, whole = contributions(model, evaluations)
    known = whole > 0.0
    order = np.argsort(-parts, kind="stable") if known else np.arange(len(parts))
    return [
        TermRow(
            formula=typeset(model.terms[t], model.envelope),
            coefficient=minus(f"{model.terms[t].coefficient:.5g}"),
            unit=coefficient_unit(model.terms[t]),
            rms_N=float(parts[t]) if known else None,
            share=float(100.0 * parts[t] / whole) if known else None,
        )
        for t in order
    ]


def contributions(model: Model, evaluations: Sequence[Evaluation]) -> tuple[F, float]:
    """Return the RMS of each term (terms,) [N] and of the simulated force [N] over all scored, finite ticks."""
    squares, total, count = np.zeros(len(model.terms)), 0.0, 0
    for evaluation in evaluations:
        kept = evaluation.series.scored & np.isfinite(evaluation.run.force)
        for start, values in term_forces(model, evaluation):
            chosen = kept[start : start + values.shape[1]]
            squares += (values[:, chosen] ** 2).sum(axis=1)
        total += float((evaluation.run.force[kept] ** 2).sum())
        count += int(kept.sum())
    return np.sqrt(squares / max(count, 1)), float(np.sqrt(total / max(count, 1)))


def term_forces(model: Model, evaluation: Evaluation) -> list[tuple[int, F]]:
    """Return the force [N] of each term along the free run, in pieces: first tick and values (terms, ticks).

    At every tick they add up to the simulated force.
    """
    series, run, terms = evaluation.series, evaluation.run, compile_terms(model.terms)
    inputs = (series.position, series.speed, series.current)
    made = constructed_values(terms.constructed, model.envelope, inputs, series.segments, series.rate_Hz)
    powers = power_table(terms.powers, model.envelope, *inputs, made)
    gain = np.array([term.coefficient for term in model.terms])[:, None]
    pieces = []
    for s, (start, stop) in enumerate(series.segments):
        for k0 in range(start, stop, CHUNK):
            k1 = min(k0 + CHUNK, stop)
            columns = kernels.regressor_columns(powers, run.force, series.segments, *terms.arrays, k0, k1, s)
            pieces.append((int(k0), gain * columns))
    return pieces


def typeset(term: Term, envelope: Envelope) -> Markup:
    """Return the product of the term's factors in HTML, inputs first; bars are left out where a signal is never < 0."""
    factors = [_factor(f, _never_negative(f, envelope)) for f in (*term.inputs, *_outputs(term))]
    return Markup(" · ").join(factors) if factors else Markup("1")


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
    made = f.definition
    if made is None:
        return UNITS[f.signal]
    return UNITS[made.of] if isinstance(made, Hysteresis | Lag) else "" if isinstance(made, Hat) else UNITS["frequency"]


def _outputs(term: Term) -> tuple[Factor, ...]:
    return tuple(f for f in term.factors if f.signal == "force")


def _factor(f: Factor, never_negative: bool) -> Markup:
    lag = f"\N{MINUS SIGN}{f.lag}" if f.lag else ""
    s = Markup('<span class="signal"><var>{}</var>(<var>k</var>{})</span>').format(SYMBOLS.get(f.signal, f.signal), lag)
    odd = f.power % 2 == 1.0
    if f.signal == "force":
        return s
    if f.power == 0.0:
        return Markup("sgn {}").format(s) if f.signed else Markup("1")
    if never_negative or (f.signed and odd) or (not f.signed and f.power % 2 == 0.0):
        return _raised(s, f.power)
    size = _raised(Markup("|{}|").format(s), f.power)
    return Markup("sgn {} · {}").format(s, size) if f.signed else size


def _raised(base: Markup, power: float) -> Markup:
    return base if power == 1.0 else Markup("{}<sup>{}</sup>").format(base, f"{power:g}")


def _never_negative(f: Factor, envelope: Envelope) -> bool:
    low = {"current": envelope.current_A, "position": envelope.position_m, "speed": envelope.speed_m_s}
    if f.definition is not None:
        return f.definition.range(envelope.by_signal)[0] >= 0.0
    return f.signal in low and low[f.signal][0] >= 0.0
