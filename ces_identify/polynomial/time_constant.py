"""The time constants that candidate rules leave open, chosen by the free-run cost on the selection ticks.

The force lags behind the current because of coil and pilot valve; a free run shows best by how much. A short search
with a guess finds a model; refitting it with other time constants gives the best of these, which is the next guess.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from ces_identify.numerics import search_clock
from ces_identify.numerics.arrays import I
from ces_identify.polynomial.constructed_rules import FIRST_GUESS_S
from ces_identify.polynomial.free_run_fit import fit_free_run
from ces_identify.polynomial.gauss_newton import GaussNewtonStart
from ces_identify.polynomial.problem import Problem, assemble_problem, coarsen
from ces_identify.polynomial.regressors import CandidateRules
from ces_identify.polynomial.search_limits import Limits, SearchResult
from ces_identify.preparation.series import Series
from ces_identify.preparation.weighting import EQUAL, Weighting

GRID_S = (0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.007, 0.0085, 0.01, 0.012, 0.014, 0.017, 0.02, 0.03, 0.05)
EVERY, AROUND = 3, 2  # grid points: step of the first pass, and reach of the second around the best
GUESSES = 3  # at most, until one is near an earlier guess
NEAR = (0.6, 1.7)  # ratio of two guesses that are near
TERMS = 12  # of the short searches
ITERATIONS = 12  # of a fit
COARSE_HZ = 250.0  # rate of searches and fits; the lag itself is computed at the model's rate
SHARE = 0.2  # of the search time, for each guess


def find_time_constants(
    rules: CandidateRules, series: Sequence[Series], limits: Limits, stable: bool = True, weighting: Weighting = EQUAL
) -> CandidateRules:
    """Return `rules` with every open time constant [s] set to that of the lowest selection cost [%] on `series`."""
    step = max(1, round(series[0].rate_Hz / COARSE_HZ)) if series else 1
    short = replace(limits, target=0.0, max_terms=min(TERMS, limits.term_limit), exchanges=False)

    def problem(choice: CandidateRules, chosen: I | None = None) -> Problem:
        terms = choice.candidates()
        terms = terms if chosen is None else tuple(terms[i] for i in chosen)
        return coarsen(assemble_problem(series, terms, stable, weighting), step)

    for name in rules.open_lags:
        guess, tried = FIRST_GUESS_S, list[float]()
        while len(tried) < GUESSES and not any(NEAR[0] < guess / one < NEAR[1] for one in tried):
            tried.append(guess)
            rules = rules.with_time_constant(name, guess)
            deadline = search_clock.now() + SHARE * limits.seconds
            start = GaussNewtonStart(problem(rules), short, limits.seed, deadline, threading.Event(), lambda f: None)
            guess = _search_grid(cache(partial(_cost_after_refit, problem, rules, name, start.run())))
        rules = rules.with_time_constant(name, guess)
    return rules


def _cost_after_refit(
    problem: Callable[[CandidateRules, I], Problem],
    rules: CandidateRules,
    name: str,
    model: SearchResult,
    seconds: float,
) -> float:
    """Return the selection cost [%] of a model refitted on the estimation ticks with another time constant."""
    trial = problem(rules.with_time_constant(name, seconds), model.chosen)
    chosen = np.arange(len(model.chosen))
    fit = fit_free_run(trial, chosen, model.coefficients, trial.estimation, ITERATIONS)
    return trial.selection_cost(chosen, fit.coefficients) if np.isfinite(fit.error) else float("inf")


def _search_grid(cost: Callable[[float], float]) -> float:
    """Return the grid's time constant of lowest cost, from a coarse pass and then those around its best."""
    best = GRID_S.index(min(GRID_S[1::EVERY], key=cost))
    return min(GRID_S[max(0, best - AROUND) : best + AROUND + 1], key=cost)
