"""Polynomial NARX models at the desk: selection of terms and fit, and the parts of the tick in C that depend on terms.

polynomial.{c,h}.j2 hold the C around powers of the inputs, their histories, and the sum.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, replace
from functools import partial
from math import pi

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import search_clock
from ces_identify.polynomial.candidates import load_rules
from ces_identify.polynomial.compiled_terms import run_polynomial
from ces_identify.polynomial.constructed import add_stroke_if_needed, find_time_constants, restrict_to_data
from ces_identify.polynomial.gauss_newton import fit_free_run, refit_coefficients
from ces_identify.polynomial.problem import Problem, assemble_problem
from ces_identify.polynomial.search_limits import THESIS, Listener, SearchResult
from ces_identify.polynomial.selection import search
from ces_identify.polynomial.term_table import term_table
from ces_identify.prepare.series import Series
from ces_identify.structures.kit import CTick, Fitted, IdentifyOptions, StructureKit, constructed_variable, number
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.structures.constructed_inputs import Frequency, Lag, TriangularMembership
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

MAX_PRODUCT_POWER = 4.0  # multiples of 1/2 up to here become products and a square root, other powers pow()

Power = tuple[str, float, bool]  # signal, power, signed


def polynomial_facts(polynomial: Polynomial, model: Model) -> dict[str, object]:
    """Return the inputs, powers, rings, lagged variables and products of the tick, in the order of the C."""
    factors = [factor for term in polynomial.terms for factor in term.factors]
    powers = sorted({_power(f) for f in factors if f.signal != "force"})
    constructed = polynomial.constructed
    names, hats = {c.name for c in constructed}, [c for c in constructed if isinstance(c, TriangularMembership)]
    used = {f.signal for f in factors} | {signal for one in constructed for signal in one.signals}
    deepest: dict[str, int] = {}
    for f in factors:
        deepest[_variable(f)] = max(f.lag, deepest.get(_variable(f), 0))
    rings = {name: {"name": name, "size": 1 << lag.bit_length()} for name, lag in sorted(deepest.items()) if lag}
    lagged = sorted({(_variable(f), f.lag) for f in factors if f.lag})
    ordered = sorted(polynomial.terms, key=_place)
    return {
        "inputs": [
            {"name": name, "argument": argument, "low": low, "high": high}
            for argument, (low, high) in asdict(model.envelope).items()
            if (name := argument.partition("_")[0]) in used
        ],
        "remembering": [one for one in constructed if not isinstance(one, TriangularMembership)],
        "memberships": {constructed_variable(one.name): _membership(one, names) for one in hats},
        "constants": {"TWO_PI": 2.0 * pi} if any(isinstance(one, Frequency) for one in constructed) else {},
        "gains": {
            one.name: one.gain(model.sampling.rate_Hz) for one in constructed if isinstance(one, Frequency | Lag)
        },
        "values": _values(powers),
        "rings": list(rings.values()),
        "histories": [ring for name, ring in rings.items() if name != "force"],
        "forces": rings.get("force"),
        "reads": [{"name": f"{name}_lag{lag}", "ring": rings[name], "lag": lag} for name, lag in lagged],
        "constant": sum(t.coefficient for t in polynomial.terms if not t.factors),
        "products": [_product(term) for term in ordered if term.factors],
    }


def _membership(membership: TriangularMembership, constructed: Collection[str]) -> str:
    """Return the expression for a membership; `constructed` are the names of all constructed inputs."""
    signal = constructed_variable(membership.of) if membership.of in constructed else membership.of
    low, high = (
        "1.0" if end is None else f"membership({signal}, {number(membership.peak)}, {number(end)})"
        for end in (membership.low, membership.high)
    )
    return f"({signal} < {number(membership.peak)}) ? {low} : {high}"


def _values(powers: Iterable[Power]) -> dict[str, str]:
    """Return the variables to compute at a tick with their expressions, in order of dependence."""
    values: dict[str, str] = {}
    for signal, power, signed in powers:
        if signed and power == 1.0:
            continue  # the clamped input itself
        magnitudes = [power] if power == 0.0 else [1.0, power]
        if _is_product(power) and power % 1.0:
            magnitudes.insert(1, 0.5)
        for p in magnitudes:
            values[_name((signal, p, False))] = _magnitude(signal, p)
        if signed:
            values[_name((signal, power, True))] = f"copysign({_name((signal, power, False))}, {signal})"
    return values


def _magnitude(signal: str, power: float) -> str:
    """Return the expression for |signal|^power."""
    if power == 1.0:
        return f"fabs({signal})"
    magnitude, root = _name((signal, 1.0, False)), _name((signal, 0.5, False))
    if power == 0.5:
        return f"sqrt({magnitude})"
    if not _is_product(power):
        return f"pow({magnitude}, {number(power)})"
    return " * ".join([magnitude] * int(power) + [root] * (power % 1.0 > 0.0)) or "1.0"


def _is_product(power: float) -> bool:
    return (2.0 * power).is_integer() and power <= MAX_PRODUCT_POWER


def _place(term: Term) -> int:
    """Return the sort key of a term's shape, in the order of `ces_observer.structures.polynomial`: roundings agree."""
    shapes = {(False, 1): 0, (False, 2): 1, (True, 1): 2, (True, 2): 3}
    return shapes.get((term.output_lag > 0, len(term.inputs)), 4)


def _product(term: Term) -> str:
    force = [f"force_lag{term.output_lag}"] if term.output_lag else []
    inputs = [_variable(f) + (f"_lag{f.lag}" if f.lag else "") for f in term.inputs]
    if force and _place(term) == 4 and inputs:
        return f"{force[0]} * ({' * '.join([number(term.coefficient), *inputs])})"
    return " * ".join([number(term.coefficient), *force, *inputs])


def _variable(factor: Factor) -> str:
    return "force" if factor.signal == "force" else _name(_power(factor))


def _power(factor: Factor) -> Power:
    signal = factor.signal if factor.definition is None else constructed_variable(factor.signal)
    return signal, float(factor.power), factor.signed


def _name(power: Power) -> str:
    """Return the variable of a power: `speed`, `speed_abs`, or for the power 1/2 `speed_p0_5`, `speed_abs_p0_5`."""
    signal, exponent, signed = power
    digits = repr(exponent).removesuffix(".0").replace(".", "_").replace("-", "m").replace("+", "")
    return signal + ("" if signed else "_abs") + ("" if exponent == 1.0 else f"_p{digits}")


NO_CANDIDATE = "no candidate lowered the cost below 100 %; check signs, signals and rules"
NO_MODEL_BY_THESIS = (
    "no model below 100 %: the free run of the initial model diverges or follows nothing, and no candidate mends that; "
    "give another initial model or more candidates, or a lower --rate"
)
REFIT_STEPS = 8
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
    return replace(problem, initial=np.arange(len(rules.initial_terms())))


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
    batch_run=run_polynomial,
    table=term_table,
    c_tick=CTick("polynomial", polynomial_facts, "polynomial"),
)
