"""Polynomial NARX models at the desk: selection of terms, fit, and the table of the terms.

The table shows each term typeset, with its contribution to the force and the meaning of its symbols.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import itemgetter

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F, I
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics import kernels
from ces_identify.numerics.search import THESIS, TIME_IS_UP, Listener, SearchResult, clock_s
from ces_identify.polynomial.constructed import find_time_constants, restrict_to_data
from ces_identify.polynomial.free_run_fit import fit_free_run, refit_coefficients
from ces_identify.polynomial.problem import Problem, assemble_problem, lay_out_terms, pieces
from ces_identify.polynomial.rules_file import load_rules
from ces_identify.polynomial.selection import search
from ces_identify.prepare.series import Series, SimulatedSeries, changes
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit
from ces_observer.errors import CesError, OptionName
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.proof.certificate import largest_gain
from ces_observer.structures.constructed_inputs import (
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
)
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.structure import Range
from ces_observer.structures.polynomial import Factor, Term
from ces_report.table import BAR, Column, Section, Table
from ces_report.typesetting import (
    UNITS,
    Chart,
    ChartCurve,
    Symbols,
    describe_signals,
    format_number,
    minus,
    signal_symbol,
    three_figures,
)

NO_CANDIDATE = "no candidate lowered the cost below 100 %; check signs, signals and rules"
NO_MODEL_BY_THESIS = (
    "no model below 100 %: the free run of the initial model diverges or follows nothing, and no candidate mends that; "
    "give another initial model or more candidates, or a lower rate"
)
REFIT_STEPS = 8
PROOF_ROOM = 0.003  # of the gain, between the probed inputs and all
COSTS_BY_TERMS = "J_percent_by_terms"  # key of the provenance's selection: numbers of terms, each with a cost
MIN_SIZES = 3  # of a chart
MAX_BUILD_SHARE = 0.5  # of a time limit, to build the problem


def fit_polynomial(
    training: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
) -> Fitted:
    """Return the best polynomial of the options' candidates; raises CesError if the series hold too little.

    A last fit on all identification data is used only if it does not worsen their free run. The thesis' procedure has
    neither that fit nor a constraint on stability; its model has a certificate if the proof succeeds.
    """
    end = clock_s() + options.limits.time
    listener("finding time constants and candidates of the polynomial")
    problem = build_problem(training, options)
    listener("choosing terms of the polynomial")
    starts = search(problem, options.limits.within(end), listener)
    results = [start for start in starts if start.cost < 100.0]
    if not results and TIME_IS_UP in {start.ended for start in starts}:
        raise CesError("the time ended before a model below 100 % was found; give more with ", OptionName("time"))
    if not results:
        raise CesError(NO_MODEL_BY_THESIS if options.limits.method == THESIS else NO_CANDIDATE)
    by_terms = costs_by_terms(results)
    listener("fitting the chosen terms and proving stability")
    method = f"{options.limits.method}, judged by free run"
    how = {"method": method, "candidates": len(problem.candidates), "most_terms": options.limits.term_limit}
    if options.limits.method == THESIS:
        model = _model(problem, sampling, results[0], refit=False)
        proof = model.certify() if options.certificate else None
        if proof is not None and proof.holds:
            model = replace(model, certificate=proof.to_mapping())
        elif proof is not None:
            how["not_proved"] = proof.doubt
    else:
        model, results = _best_model(problem, sampling, results, options.certificate)
    costs = {**by_terms, len(results[0].chosen): results[0].cost}
    how[COSTS_BY_TERMS] = [list(pair) for pair in sorted(costs.items())]  # as a file holds them
    return Fitted(model, results, how, partial(_refit, problem, model, results[0].chosen))


def costs_by_terms(results: Iterable[SearchResult]) -> dict[int, float]:
    """Return the lowest selection cost [%] of the models that a search met, by their number of terms."""
    costs: dict[int, float] = {}
    for model in (model for start in results for model in (start, *start.met) if model.cost < 100.0):
        costs[len(model.chosen)] = min(model.cost, costs.get(len(model.chosen), 100.0))
    return costs


def build_problem(training: Sequence[Series], options: IdentifyOptions) -> Problem:
    """Return the problem of choosing terms on prepared series, with all open time constants determined.

    What a time limit ends is left as it is.
    """
    end = clock_s() + MAX_BUILD_SHARE * options.limits.time
    rules = options.candidates or load_rules(None, options.limits.method)
    stable = options.certificate and options.limits.method != THESIS
    if not changes(np.concatenate([series.current for series in training])):
        rules = rules.without_signal("current")
    rules = restrict_to_data(rules.at_rate(training[0].rate_Hz), training)
    rules = find_time_constants(rules, training, options.limits.within(end), stable, options.weight)
    problem = assemble_problem(training, rules.candidates(), stable, options.weight)
    past = max((term.output_lag for term in problem.candidates), default=0)
    inputs = max((f.lag for term in problem.candidates for f in term.inputs), default=0)
    gain = largest_gain(options.forget, past, inputs, training[0].rate_Hz) - PROOF_ROOM
    return replace(
        problem,
        initial=np.arange(len(rules.initial_terms())),
        max_gain=min(problem.max_gain, gain) if stable else np.inf,
    )


def _best_model(
    problem: Problem, sampling: Sampling, results: Sequence[SearchResult], prove: bool
) -> tuple[Model, list[SearchResult]]:
    """Return the best model (with `prove`, with a certificate), its result and those of the starts that are no better.

    Models that a start met on its way count, too.
    """
    met = [
        result
        for start in results
        for result in (start, *(replace(m, ended=start.ended) for m in start.met if start.cost < m.cost < 100.0))
    ]
    for best in sorted(met, key=lambda result: result.cost) if prove else results[:1]:
        model = _model(problem, sampling, best)
        if prove and not model.is_stable():
            continue
        if prove:
            model = replace(model, certificate=model.certify().to_mapping())
        return model, [best, *(result for result in results if result.cost >= best.cost and result is not best)]
    advice = "multiply past forces by fewer different lags, or give "
    raise CesError(f"no model could be proved stable; {advice}", OptionName("certificate", False))


def _model(problem: Problem, sampling: Sampling, best: SearchResult, refit: bool = True) -> Model:
    try:
        coefficients = refit_coefficients(problem, best) if refit else best.coefficients
    except KeyboardInterrupt:
        coefficients = best.coefficients
    terms = [Term(float(c), problem.candidates[i].factors) for c, i in zip(coefficients, best.chosen, strict=True)]
    return Model(sampling, Polynomial(tuple(terms)), problem.envelope, problem.force_envelope)


def _refit(problem: Problem, model: Model, chosen: I, weights: F) -> Model | None:
    """Return the model with coefficients fitted to the weighted ticks, as `Fitted.refit` describes it."""
    assert isinstance(model.body, Polynomial)
    coefficients = np.array([term.coefficient for term in model.body.terms])
    fit = fit_free_run(problem, chosen, coefficients, weights * problem.everything, REFIT_STEPS)
    terms = [replace(t, coefficient=float(c)) for t, c in zip(model.body.terms, fit.coefficients, strict=True)]
    return replace(model, body=Polynomial(tuple(terms))) if np.isfinite(fit.error) else None


SIGN = (Markup("sgn"), "sign: \N{MINUS SIGN}1, 0 or 1")


def describe_symbols(terms: Iterable[Term], rate_Hz: float) -> Symbols:
    """Return the symbols that appear in `terms` with their meanings; the logged signals and the tick come first."""
    factors = [factor for term in terms for factor in term.factors]
    logged = describe_signals(("force", *(f.signal for f in factors if f.definition is None)), rate_Hz)
    definitions = [d for f in factors for d in (getattr(f.definition, "base", None), f.definition) if d is not None]
    constructed = {definition.name: definition for definition in definitions}
    symbols = [(Markup("<var>{}</var>").format(d.name), describe_input(d)) for d in constructed.values()]
    signed = any(f.signed and f.signal != "force" and f.power % 2 != 1.0 for f in factors)
    return (*logged, *symbols, *([SIGN] if signed else []))


def describe_input(definition: ConstructedInput) -> str:
    """Return how a constructed input is computed, in words with its numbers."""
    if isinstance(definition, Frequency):
        low, high = definition.range_Hz
        return f"frequency of the motion over the last {definition.time_constant_s:g} s, within {low:g} to {high:g} Hz"
    if isinstance(definition, Lag):
        time_ms, unit = 1e3 * definition.time_constant_s, UNITS[definition.of]
        return f"{definition.of} behind a first-order lag of {time_ms:g} ms [{unit}]"
    if isinstance(definition, Hysteresis):
        width = f"\N{PLUS-MINUS SIGN}{definition.half_width:g} {UNITS[definition.of]}"
        if definition.kind == "stop":
            return f"change of the {definition.of} since its last reversal, limited to {width}"
        return f"{definition.of} with a play of {width}: it stands still after a reversal until the play is used up"
    ends = [f"{end:g}" for end in (definition.low, definition.high) if end is not None]
    return f"membership of {definition.of}: 1 at {definition.peak:g}, falling to 0 at {' and '.join(ends)}"


NOTE = (
    "RMS of each term along the free run over the {} recordings, and its ratio to the RMS of the simulated force; "
    "terms may cancel, so the shares need not add up to 100\N{NO-BREAK SPACE}%."
)
BY_TERMS = (
    "The lowest J of the models of each size that the search met, before the last fit. {0} terms are within {1:.0f}"
    "\N{NO-BREAK SPACE}% of the lowest: --terms {0} asks for so many at most."
)
NO_RUN = "–: no simulated force to compare a term with, since no recording was run or every run diverged at once."
COLUMNS: tuple[Column[Sequence[str]], ...] = (
    Column("Regressor", itemgetter(0), css="formula"),
    Column("Coefficient", itemgetter(1), figure=True),
    Column("Unit", itemgetter(2), css="unit"),
    Column("RMS [N]", itemgetter(3), figure=True),
    Column("Of the force [%]", itemgetter(4), css="j", head_css="j"),
)


def term_table(polynomial: Polynomial, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the terms by their contribution to the free runs, largest first; `role` names the recordings' role."""
    parts, whole = contributions(polynomial, model, runs)
    order = np.argsort(-parts, kind="stable") if whole > 0.0 else np.arange(len(parts))
    rows = []
    for t in order:
        term, cells = polynomial.terms[t], ("\N{EN DASH}", "\N{EN DASH}")
        if whole > 0.0:
            part, share = float(parts[t]), 100.0 * float(parts[t]) / whole
            cells = three_figures(part), BAR.format(three_figures(share), min(share, 100.0), "")
        name, coefficient = format_term(term, model.envelope), format_number(term.coefficient, 5)
        rows.append((name, coefficient, coefficient_unit(term), *cells))
    equation = Markup("<var>F</var>(<var>k</var>) = Σ coefficient · regressor")
    symbols = describe_symbols(polynomial.terms, model.sampling.rate_Hz)
    note = NOTE.format(role) if whole > 0.0 else NO_RUN
    return Section("terms", "Regressors", Table(COLUMNS, rows), note, equation, symbols)


def size_sections(model: Model) -> list[Section]:
    """Return the cost over the number of terms along the search, if the model is a polynomial whose file has it."""
    known = model.provenance.get("selection", {}).get(COSTS_BY_TERMS, ())
    if not isinstance(model.body, Polynomial) or len(known) < MIN_SIZES:
        return []
    terms, costs = np.array(known, np.float64).T
    own = terms == len(model.body.terms)
    enough = int(terms[costs <= (1.0 + ChoiceLimits.COST_TOLERANCE) * costs.min()][0])
    ends, none = (float(terms[0]), float(terms[-1])), np.zeros(len(terms))
    curves = (
        ChartCurve("best of each size", terms, costs, none, ends, (terms, costs), "best of each size"),
        ChartCurve("this model", terms[own], costs[own], none[own], ends, (terms[own], costs[own]), "this model"),
    )
    caption = BY_TERMS.format(enough, 100.0 * ChoiceLimits.COST_TOLERANCE)
    chart = Chart("Cost over the number of terms", "Terms", "J on the selection ticks [%]", curves, caption)
    return [Section("size", "Terms against cost", charts=(chart,))]


def contributions(polynomial: Polynomial, model: Model, runs: Sequence[SimulatedSeries]) -> tuple[F, float]:
    """Return the RMS of each term (terms,) [N] and of the simulated force [N] over all scored, finite ticks."""
    squares, total, count = np.zeros(len(polynomial.terms)), 0.0, 0
    for simulated in runs:
        scored = simulated.series.scored & np.isfinite(simulated.run.force)
        for start, values in term_forces(polynomial, model, simulated):
            mask = scored[start : start + values.shape[1]]
            squares += (values[:, mask] ** 2).sum(axis=1)
        total += float((simulated.run.force[scored] ** 2).sum())
        count += int(scored.sum())
    return np.sqrt(squares / max(count, 1)), float(np.sqrt(total / max(count, 1)))


def term_forces(polynomial: Polynomial, model: Model, simulated: SimulatedSeries) -> list[tuple[int, F]]:
    """Return each term's force [N] along the free run, which they add up to: pieces of first tick, (terms, ticks)."""
    series, run = simulated.series, simulated.run
    terms = lay_out_terms(polynomial.terms)
    powers = terms.power_table(model.envelope, series.inputs, series.segments, model.sampling.rate_Hz)
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


POLYNOMIAL = StructureKit(
    about="polynomial NARX",
    body=Polynomial,
    sizes=(),
    fitter=lambda sizes: fit_polynomial,
    table=term_table,
)
