"""Polynomial NARX models offline: selection of terms and fit; prepared series in, a model out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_identify.numerics import search_clock
from ces_identify.polynomial.constructed_data import restrict_to_data
from ces_identify.polynomial.free_run import run_polynomial
from ces_identify.polynomial.problem import Problem, assemble_problem
from ces_identify.polynomial.refit import refit_coefficients
from ces_identify.polynomial.regressors import CandidateRules, load_rules
from ces_identify.polynomial.search_limits import THESIS, Listener, SearchResult
from ces_identify.polynomial.selection import search
from ces_identify.polynomial.term_table import term_table
from ces_identify.polynomial.time_constant import find_time_constants
from ces_identify.preparation.series import Series
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term

NO_CANDIDATE = "no candidate lowered the cost below 100 %; check signs, signals and rules, or give more time"
NO_MODEL_BY_THESIS = (
    "no model below 100 %: the free run of the initial model diverges or follows nothing, and no candidate mends that; "
    "give another initial model or more candidates, a lower --rate or more time"
)
MIN_SEARCH_SHARE = 0.5  # of the time limit that the search gets, however long it took to build the problem


def fit_polynomial(
    training: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
) -> Fitted:
    """Return the best polynomial of the options' candidates; raises CesError if the series hold too little.

    A last fit on all identification data is used only if it does not worsen their free run. The thesis' procedure has
    neither that fit nor a constraint on stability; its model has a certificate if the proof succeeds.
    """
    started = search_clock.now()
    problem = build_problem(training, options)
    seconds = max(MIN_SEARCH_SHARE * options.limits.seconds, options.limits.seconds - (search_clock.now() - started))
    limits = replace(options.limits, seconds=seconds)
    results = [f for f in search(problem, limits, listener) if f.cost < 100.0]
    if not results:
        raise CesError(NO_MODEL_BY_THESIS if options.limits.method == THESIS else NO_CANDIDATE)
    how = {
        "method": f"{options.limits.method}, judged by free run",
        "candidates": len(problem.candidates),
        "most_terms": options.limits.term_limit,
    }
    if options.limits.method == THESIS:
        model, doubt = _certify_if_stable(_model(problem, sampling, results[0], refit=False), options.certify)
        how |= {"not_proved": doubt} if doubt else {}
    else:
        model, results = _best_model(problem, sampling, results, options.certify)
    return Fitted(model, results, how)


def build_problem(training: Sequence[Series], options: IdentifyOptions) -> Problem:
    """Return the problem of choosing terms on prepared series, with all open time constants determined."""
    rules = options.rules or load_rules(None, options.limits.method)
    stable = options.certify and options.limits.method != THESIS
    rules = _restrict_rules(rules.at_rate(training[0].rate_Hz), training)
    rules = find_time_constants(rules, training, options.limits, stable, options.weighting)
    problem = assemble_problem(training, rules.candidates(), stable, options.weighting)
    return replace(problem, initial=np.arange(len(rules.initial_terms())))


def _restrict_rules(rules: CandidateRules, training: Sequence[Series]) -> CandidateRules:
    """Return the rules without products of a constant current, and with constructed inputs in range of the data."""
    current = np.concatenate([series.current for series in training])
    constant = np.ptp(current) <= 1e-3 * max(1e-9, float(np.abs(current).max()))
    return restrict_to_data(rules.without_signal("current") if constant else rules, training)


def _best_model(
    problem: Problem, sampling: Sampling, results: Sequence[SearchResult], prove: bool
) -> tuple[Model, list[SearchResult]]:
    """Return the model of the best start (with `prove`, of the best with a certificate) and the starts from it on."""
    for i, best in enumerate(results):
        model = _model(problem, sampling, best)
        if not prove:
            return model, list(results)
        if model.is_stable():
            return replace(model, certificate=model.certify().to_mapping()), list(results[i:])
    raise CesError(
        "no model could be proved stable; multiply past forces by fewer different lags, or give --no-certificate"
    )


def _certify_if_stable(model: Model, prove: bool) -> tuple[Model, str]:
    """Return the model, with `prove` and if it can be proved stable with its certificate, and the doubt otherwise."""
    proof = model.certify() if prove else None
    if proof is None or not proof.holds:
        return model, proof.doubt if proof else ""
    return replace(model, certificate=proof.to_mapping()), ""


def _model(problem: Problem, sampling: Sampling, best: SearchResult, refit: bool = True) -> Model:
    try:
        coefficients = refit_coefficients(problem, best) if refit else best.coefficients
    except KeyboardInterrupt:
        coefficients = best.coefficients
    terms = [Term(float(c), problem.candidates[i].factors) for c, i in zip(coefficients, best.chosen, strict=True)]
    return Model(sampling, Polynomial(tuple(terms)), problem.envelope, problem.force_envelope)


POLYNOMIAL = StructureKit(
    option="polynomial",
    about="polynomial NARX",
    body=Polynomial,
    sizes=(),
    fitter=lambda sizes: fit_polynomial,
    batch_run=run_polynomial,
    table=term_table,
)
