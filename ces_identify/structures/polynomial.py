"""Polynomial NARX models at the desk: selection of terms, and fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import search_clock
from ces_identify.polynomial.constructed import add_stroke_if_needed, find_time_constants, restrict_to_data
from ces_identify.polynomial.gauss_newton import fit_free_run, refit_coefficients
from ces_identify.polynomial.problem import Problem, assemble_problem
from ces_identify.polynomial.rules_file import load_rules
from ces_identify.polynomial.search_limits import THESIS, Listener, SearchResult
from ces_identify.polynomial.selection import search
from ces_identify.polynomial.term_table import term_table
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.proof.certificate import largest_gain
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term

NO_CANDIDATE = "no candidate lowered the cost below 100 %; check signs, signals and rules"
NO_MODEL_BY_THESIS = (
    "no model below 100 %: the free run of the initial model diverges or follows nothing, and no candidate mends that; "
    "give another initial model or more candidates, or a lower --rate"
)
REFIT_STEPS = 8
PROOF_ROOM = 0.003  # of the gain, between the probed inputs and all
MAX_BUILD_SHARE = 0.5  # of a time limit, to build the problem


def fit_polynomial(
    training: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
) -> Fitted:
    """Return the best polynomial of the options' candidates; raises CesError if the series hold too little.

    A last fit on all identification data is used only if it does not worsen their free run. The thesis' procedure has
    neither that fit nor a constraint on stability; its model has a certificate if the proof succeeds.
    """
    end = search_clock.now() + options.limits.time
    problem = build_problem(training, options)
    results = [f for f in search(problem, options.limits.within(end), listener) if f.cost < 100.0]
    if not results:
        raise CesError(NO_MODEL_BY_THESIS if options.limits.method == THESIS else NO_CANDIDATE)
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
    return Fitted(model, results, how, partial(_refit, problem, model, results[0].chosen))


def build_problem(training: Sequence[Series], options: IdentifyOptions) -> Problem:
    """Return the problem of choosing terms on prepared series, with all open time constants determined.

    The built-in rules get sub-models over the stroke if the data ask for them. What a time limit ends is left as it is.
    """
    end = search_clock.now() + MAX_BUILD_SHARE * options.limits.time
    rules = options.candidates or load_rules(None, options.limits.method)
    built_in = rules == load_rules(None)
    stable = options.certificate and options.limits.method != THESIS
    current = np.concatenate([series.current for series in training])
    if np.ptp(current) <= 1e-3 * max(1e-9, float(np.abs(current).max())):
        rules = rules.without_signal("current")
    rules = restrict_to_data(rules.at_rate(training[0].rate_Hz), training)
    rules = find_time_constants(rules, training, options.limits.within(end), stable, options.weight)
    if built_in:
        rules = add_stroke_if_needed(rules, training, options.limits.within(end), stable, options.weight)
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
        one
        for start in results
        for one in (start, *(replace(m, ended=start.ended) for m in start.met if start.cost < m.cost < 100.0))
    ]
    for best in sorted(met, key=lambda one: one.cost) if prove else results[:1]:
        model = _model(problem, sampling, best)
        if prove and not model.is_stable():
            continue
        if prove:
            model = replace(model, certificate=model.certify().to_mapping())
        return model, [best, *(one for one in results if one.cost >= best.cost and one is not best)]
    raise CesError(
        "no model could be proved stable; multiply past forces by fewer different lags, or give --no-certificate"
    )


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


POLYNOMIAL = StructureKit(
    about="polynomial NARX",
    body=Polynomial,
    sizes=(),
    fitter=lambda sizes: fit_polynomial,
    table=term_table,
)
