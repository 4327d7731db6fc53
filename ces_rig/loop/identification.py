"""Identifies a model from all recordings of an iteration, or improves the parameters of the one before.

A search of its own ends early at Ctrl-C and keeps its best model; here the program stops.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import FrameType

import numpy as np

from ces_data.arrays import F
from ces_data.checks.check import require_consistent
from ces_data.recording import Recording
from ces_identify.identification import cross_fit
from ces_identify.numerics.search import INTERRUPTED, Listener, SearchResult
from ces_identify.polynomial.free_run_fit import fit_free_run
from ces_identify.polynomial.problem import Problem, assemble_problem
from ces_identify.prepare.series import Series, prepare
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.validation.evaluate import VALIDATION, Evaluation, cost_interval, evaluate, pooled_cost
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term
from ces_rig.loop.plan import IdentifyPlan

REFIT_STEPS = 20
REFITTED = "parameters of the model before, improved"


def identify_all(
    recordings: Sequence[Recording], plan: IdentifyPlan, seed: int, listener: Listener, previous: Model | None = None
) -> tuple[Model, tuple[Model, ...], float]:
    """Identify a model on all recordings; with `previous`, improve its parameters only, if its structure allows that.

    Returns the model, those that have not seen all recordings, and its cost J [%] on all recordings together.
    Raises CesError if the recordings contradict each other or hold too little; Ctrl-C leaves no model.
    """
    require_consistent(recordings)
    request = plan.request(seed)
    options, fitter = request.options(), request.fitter()
    if previous is not None and isinstance(previous.body, Polynomial):
        options, fitter = replace(options, rate=previous.sampling.rate_Hz), refitter(previous)
    with interruptible():
        crossed = cross_fit(recordings, options, listener, fitter)
    if any(search.ended == INTERRUPTED for search in crossed.result.search_results):
        raise KeyboardInterrupt  # a search with a handler of its own for Ctrl-C ends early instead
    return crossed.result.model, crossed.models, pooled_cost(crossed.result.evaluations)


def evaluate_fresh(model: Model, recording: Recording) -> Evaluation:
    """Return the free run of a model on a recording that it has not seen."""
    return evaluate(model, [prepare(recording, model.sampling)], VALIDATION)[0]


def score_fresh(model: Model, recording: Recording) -> dict[str, float | None]:
    """Return the cost [%] of a model on a recording that it has not seen, and the upper end of its 95 % interval."""
    evaluation = evaluate_fresh(model, recording)
    interval = cost_interval([evaluation])
    return {"fresh_J": evaluation.cost, "fresh_high_J": None if interval is None else interval.high}


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt after the block if Ctrl-C came inside it, even if the block caught the exception.

    Only the main thread of a program that does not ignore Ctrl-C can notice it.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before in (signal.SIG_IGN, None):
        yield
        return
    came: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        came.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt


def refitter(previous: Model) -> Fitter:
    """Return a fitter that improves the coefficients of the polynomial `previous` on new data and keeps its terms."""

    def fit(series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener) -> Fitted:
        problem = assemble_problem(series, _terms(previous), options.certificate, options.weight)
        old = Model(sampling, previous.body, problem.envelope, problem.force_envelope)
        better = _improve(problem, old, np.ones(len(problem.everything)))
        model = better if better is not None and better.is_stable() else old
        coefficients = np.array([term.coefficient for term in _terms(model)])
        terms = np.arange(len(coefficients))
        cost = problem.selection_cost(terms, coefficients)
        result = SearchResult(terms, coefficients, cost, options.limits.seed, 1, "improved")
        listener(result)
        certified = replace(model, certificate=model.certify().to_mapping())
        return Fitted(certified, [result], {"method": REFITTED}, partial(_improve, problem, certified))

    return fit


def _improve(problem: Problem, model: Model, weights: F) -> Model | None:
    """Return the model with coefficients fitted to the weighted ticks; None if its free run diverges."""
    terms = _terms(model)
    start = np.array([term.coefficient for term in terms])
    fit = fit_free_run(problem, np.arange(len(terms)), start, weights * problem.everything, REFIT_STEPS)
    changed = [replace(t, coefficient=float(c)) for t, c in zip(terms, fit.coefficients, strict=True)]
    return replace(model, body=Polynomial(tuple(changed))) if np.isfinite(fit.error) else None


def _terms(model: Model) -> tuple[Term, ...]:
    assert isinstance(model.body, Polynomial)
    return model.body.terms
