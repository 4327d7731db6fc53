"""Constructed inputs in a search: sub-models, ranges in the data, and open time constants.

The force lags behind the current because of coil and pilot valve; a free run shows best by how much. A short search
with a guess finds a model; refitting it with other time constants gives the best of these, which is the next guess.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from math import inf

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.search import Limits, SearchResult, SearchStart, clock_s
from ces_identify.polynomial.candidate_rules import CandidateRules, SignalRule
from ces_identify.polynomial.free_run_fit import fit_free_run
from ces_identify.polynomial.problem import Problem, assemble_problem, coarsen, signal_values
from ces_identify.polynomial.rules_file import FIRST_GUESS_S, constructions_from
from ces_identify.polynomial.selection import GaussNewtonSearch
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.prepare.series import Series
from ces_observer.errors import CesError, OptionName
from ces_observer.model import Envelope
from ces_observer.structures.constructed_inputs import (
    BASE,
    ConstructedInput,
    Frequency,
    Hysteresis,
    Lag,
    TriangularMembership,
)

CURRENT, VALVE = "current", "valve"  # a blend over the current is one over the valve's if the rules have only that
MAX_BLENDED_INPUTS = 2  # inputs of a term besides its membership
NO_LAG = SignalRule((0,))


def add_blend(rules: CandidateRules, spec: str) -> CandidateRules:
    """Return `rules` with each product repeated for every sub-model of a blend; raises CesError.

    `spec` is `SIGNAL:A,B,...`: one sub-model applies at A (and below), one at B, and so on (and above the last), with
    linear blending between; SIGNAL is position, speed, current or a constructed input of `rules`. If these use only the
    valve's current, `current` means that, as a proof would treat the two as independent. The original products remain
    for the part that the sub-models share.
    """
    of, _, text = spec.partition(":")
    of = VALVE if of == CURRENT and CURRENT not in rules.signals and VALVE in rules.signals else of
    smooth = [name for name, group in rules.constructed.items() if not isinstance(group[0], TriangularMembership)]
    signals = (*BASE, *smooth)
    if of not in signals:
        raise CesError(f"'{spec}': expected SIGNAL:A,B,... with a signal among {', '.join(signals)}")
    name = f"by_{of}"
    if name in rules.constructed:
        once = OptionName("blend")
        raise CesError(f"constructed input '{name}': is defined already; give ", once, " once for a signal")
    try:
        peaks = [float(peak) for peak in text.split(",") if peak]
    except ValueError:
        raise CesError(f"'{spec}': expected numbers after the colon, with commas between") from None
    blended = [p for p in rules.products if len(set(p) - {"force"}) <= MAX_BLENDED_INPUTS]
    beside = rules.beside_force.get(of, rules.signals.get(of, NO_LAG))  # the lag beside past forces keeps proofs short
    raw = {name: {"kind": "hats", "of": of, "at": peaks}}
    return replace(
        rules,
        signals={**rules.signals, name: beside.with_last_lag()},
        products=(*rules.products, *((name, *p) for p in blended)),
        constructed=constructions_from(raw, "constructed", rules.constructed),
    )


ANYTHING = Envelope((-inf, inf), (-inf, inf), (-inf, inf))
MARGIN = 0.1  # of the data's range, added at both ends of a frequency's range


def restrict_to_data(rules: CandidateRules, series: Sequence[Series]) -> CandidateRules:
    """Return `rules` with the range of each frequency narrowed to that of `series`.

    Raises CesError for a membership that peaks outside the data, or a hysteresis wider than the data. A lag with an
    open time constant is assumed to have the range of its signal.
    """
    constructed = {
        name: tuple(_fit_to_data(definition, series, rules.open_lags) for definition in group)
        for name, group in rules.constructed.items()
    }
    return replace(rules, constructed=constructed)


def _fit_to_data(definition: ConstructedInput, series: Sequence[Series], open_lags: Sequence[str]) -> ConstructedInput:
    if isinstance(definition, TriangularMembership):
        base = None if definition.base is None else _fit_to_data(definition.base, series, open_lags)
        lag = base if isinstance(base, Lag) and base.name in open_lags else None
        data = _scored_values(lag.of, None, series) if lag else _scored_values(definition.of, base, series)
        if not data.min() <= definition.peak <= data.max():
            raise CesError(
                f"{definition.name}: peaks at {definition.of} {definition.peak:g}, outside the data's {data.min():g} "
                f"to {data.max():g}; expected peaks between"
            )
        return replace(definition, base=base)
    if isinstance(definition, Frequency):
        (low, high), data = definition.range_Hz, _scored_values(definition.name, definition, series)
        margin = MARGIN * float(np.ptp(data))
        narrow = max(low, float(data.min()) - margin), min(high, float(data.max()) + margin)
        if not narrow[0] < narrow[1]:
            raise CesError(
                f"{definition.name}: the data stay at {data.min():g} Hz; expected motion within {low:g}-{high:g} Hz"
            )
        return replace(definition, range_Hz=narrow)
    data = _scored_values(definition.of, None, series)
    if isinstance(definition, Hysteresis) and 2.0 * definition.half_width >= np.ptp(data):
        raise CesError(
            f"{definition.name}: half width {definition.half_width:g} spans all of the data's {definition.of}, "
            f"{data.min():g} to {data.max():g}; expected a narrower hysteresis"
        )
    return definition


def _scored_values(signal: str, definition: ConstructedInput | None, series: Sequence[Series]) -> F:
    """Return the values (n,) of a signal on all scored ticks."""
    definitions, values = [] if definition is None else [definition], []
    for s in series:
        by_signal = signal_values(definitions, ANYTHING, s.inputs, s.segments, s.rate_Hz)
        values.append(by_signal[signal][s.scored])
    return np.concatenate(values)


GRID_S = (0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.007, 0.0085, 0.01, 0.012, 0.014, 0.017, 0.02, 0.03, 0.05)
EVERY, AROUND = 3, 2  # grid points: step of a coarse first pass, and reach of the second around its best
GUESSES = 3  # at most, until one is near an earlier guess
NEAR = (0.6, 1.7)  # ratio of two guesses that are near
TERMS = 12  # of the short searches
ITERATIONS = 12  # of a fit
COARSE_HZ = 250.0  # rate of searches and fits; the lag itself is computed at the model's rate


def find_time_constants(
    rules: CandidateRules, series: Sequence[Series], limits: Limits, stable: bool = True, weighting: Weighting = EQUAL
) -> CandidateRules:
    """Return `rules` with every open time constant [s] set to that of the lowest selection cost [%] on `series`.

    When the time is up, one that has not been searched for is FIRST_GUESS_S.
    """
    end = clock_s() + limits.time

    def problem(name: str, seconds: float, chosen: I | None = None) -> Problem:
        return _coarse_problem(rules.with_time_constant(name, seconds), series, stable, weighting, chosen)

    for name in rules.open_lags:
        guess, tried = FIRST_GUESS_S, list[float]()
        while len(tried) < GUESSES and not any(NEAR[0] < guess / earlier < NEAR[1] for earlier in tried):
            tried.append(guess)
            rules = rules.with_time_constant(name, guess)
            model = _search_shortly(problem(name, guess), limits.within(end))
            if clock_s() > end:
                break
            cost = cache(partial(_cost_after_refit, partial(problem, name), model))
            best = GRID_S.index(min(GRID_S[1::EVERY], key=cost))
            guess = min(GRID_S[max(0, best - AROUND) : best + AROUND + 1], key=cost)
        rules = rules.with_time_constant(name, guess)
    return rules


def _coarse_problem(
    rules: CandidateRules, series: Sequence[Series], stable: bool, weighting: Weighting, chosen: I | None = None
) -> Problem:
    """Return the problem at about COARSE_HZ, with only the candidates at the indices `chosen` if there are any."""
    terms = rules.candidates()
    terms = terms if chosen is None else tuple(terms[i] for i in chosen)
    step = max(1, round(series[0].rate_Hz / COARSE_HZ))
    return coarsen(assemble_problem(series, terms, stable, weighting), step)


def _search_shortly(problem: Problem, limits: Limits) -> SearchResult:
    short = replace(limits, target=0.0, terms=TERMS, exchanges=False)
    return GaussNewtonSearch(problem, SearchStart(short)).run()


def _cost_after_refit(problem: Callable[[float, I], Problem], model: SearchResult, seconds: float) -> float:
    """Return the selection cost [%] of a model refitted on the estimation ticks with another time constant [s]."""
    trial = problem(seconds, model.chosen)
    chosen = np.arange(len(model.chosen))
    fit = fit_free_run(trial, chosen, model.coefficients, trial.estimation, ITERATIONS)
    return trial.selection_cost(chosen, fit.coefficients) if np.isfinite(fit.error) else float("inf")
