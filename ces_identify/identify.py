"""Identification from end to end: recordings in, a model with its costs out.

Sampling rules from the positions, preparation, candidates, selection, and a last fit on all identification data that
is kept only if it does not make their free run worse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ces_identify.numerics import search_clock
from ces_identify.polynomial.constructed_data import within_data
from ces_identify.polynomial.limits import Found, Limits, Listener
from ces_identify.polynomial.problem import Problem, pose
from ces_identify.polynomial.refit import refitted
from ces_identify.polynomial.regressors import Rules, load_rules
from ces_identify.polynomial.selection import search
from ces_identify.polynomial.time_constant import settled
from ces_identify.preparation.sampling import choose_sampling
from ces_identify.preparation.series import Series, prepare
from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.recordings.recording import Recording
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, evaluate
from ces_identify.validation.usage import RULE, usage
from ces_observer import __version__
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling, Term
from ces_observer.proof.certificate import certify, is_contraction

LEAST_SCORED = 50  # ticks of a held-out part worth judging
LEAST_SHARE = 0.5  # of the time that is left to the search, however long posing took


@dataclass(frozen=True)
class Options:
    """What to identify and how: share of each recording to identify on, rules, limits, and numbers given by hand.

    `weighting` tells which ticks matter more in fit and selection. With `certify`, only models whose stability is
    proved (ces_observer.proof.certificate) are considered.
    """

    split: float = 0.75
    rules: Rules = field(default_factory=lambda: load_rules(None))
    limits: Limits = field(default_factory=Limits)
    rate_Hz: float | None = None
    bandwidth_Hz: float | None = None
    certify: bool = True
    weighting: Weighting = EQUAL


@dataclass(frozen=True)
class Identified:
    """A model, its evaluations (identification first, then validation) and what every start found, best first."""

    model: Model
    evaluations: tuple[Evaluation, ...]
    found: tuple[Found, ...]


def identify(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    options: Options | None = None,
    listener: Listener = lambda found: None,
) -> Identified:
    """Identify a polynomial NARX model on the first `split` of every recording.

    It is validated on the rest of them and on the whole of the `validation` recordings, which neither the fit nor the
    selection sees. Raises CesError if the data hold too little.
    """
    options = options or Options()
    seen_positions = [recording.opening(options.split) for recording in recordings]
    sampling = choose_sampling(seen_positions, options.rate_Hz, options.bandwidth_Hz)
    whole = [prepare(recording, sampling) for recording in recordings]
    training = [series.part(0.0, options.split) for series in whole]
    began = search_clock.now()
    problem = posed(training, options)
    seconds = max(LEAST_SHARE * options.limits.seconds, options.limits.seconds - (search_clock.now() - began))
    limits = replace(options.limits, seconds=seconds)
    found = [f for f in search(problem, limits, listener) if f.cost < 100.0]
    if not found:
        raise CesError("no candidate lowered the cost below 100 %: check signs, signals and rules, or give more time")
    model, found = _best_model(problem, sampling, found, options.certify)
    how = {
        "method": f"{options.limits.method}, judged by free run",
        "candidates": len(problem.candidates),
        "most_terms": options.limits.most_terms,
    }
    return judged(model, found, how, (recordings, whole), validation, options)


def posed(training: Sequence[Series], options: Options) -> Problem:
    """Return the problem of choosing terms on prepared series, with every open time constant found."""
    rules = _useful_rules(options.rules.at_rate(training[0].rate_Hz), training)
    rules = settled(rules, training, options.limits, options.certify, options.weighting)
    return pose(training, rules.candidates(), options.certify, options.weighting)


def judged(
    model: Model,
    found: Sequence[Found],
    how: Mapping[str, Any],
    source: tuple[Sequence[Recording], Sequence[Series]],
    validation: Sequence[Recording],
    options: Options,
) -> Identified:
    """Return `model` with its costs and where it comes from.

    `source` holds the recordings it was identified on and their whole series; `how` tells how it was chosen.
    """
    recordings, whole = source
    seen = [series.part(0.0, options.split) for series in whole]
    held_out = _held_out(whole, options.split) + [prepare(recording, model.sampling) for recording in validation]
    evaluations = evaluate(model, seen, IDENTIFICATION) + evaluate(model, held_out, VALIDATION)
    history = {
        "tool": f"ces_observer {__version__}",
        "identification": [_origin(r) | {"share": [0.0, options.split]} for r in recordings],
        "validation": [_origin(r) for r in validation],
        "usage": usage(seen, held_out),
        "usage_rule": RULE,
        "cost_J_percent": [
            {"recording": e.name, "role": e.role, "J": round(e.cost, 4) if np.isfinite(e.cost) else None}
            for e in evaluations
        ],
        "selection": {**how, **_search_facts(found, options.limits), **_weights_told(options.weighting)},
    }
    return Identified(replace(model, provenance=history), tuple(evaluations), tuple(found))


def _weights_told(weighting: Weighting) -> dict[str, str]:
    return {"weights": str(weighting)} if weighting else {}


def _search_facts(found: Sequence[Found], limits: Limits) -> dict[str, Any]:
    return {
        "starts": len(found),
        "first_seed": limits.seed,
        "best_seed": found[0].seed,
        "seconds": limits.seconds,
        "trials": sum(f.trials for f in found),
        "ended": found[0].ended,
    }


def _useful_rules(rules: Rules, training: Sequence[Series]) -> Rules:
    """Return the rules without products of a current that does not change, and with what they construct in range."""
    current = np.concatenate([series.current for series in training])
    constant = np.ptp(current) <= 1e-3 * max(1e-9, float(np.abs(current).max()))
    return within_data(rules.without("current") if constant else rules, training)


def _best_model(problem: Problem, sampling: Sampling, found: Sequence[Found], prove: bool) -> tuple[Model, list[Found]]:
    """Return the model of the best start, with `prove` of the best whose proof succeeds, and the starts from it on."""
    for i, best in enumerate(found):
        model = _model(problem, sampling, best)
        if not prove:
            return model, list(found)
        if is_contraction(model):
            return replace(model, certificate=certify(model).to_mapping()), list(found[i:])
    raise CesError(
        "no model found could be proved stable; let past forces be multiplied by fewer different lags, or give "
        "--no-certificate"
    )


def _model(problem: Problem, sampling: Sampling, best: Found) -> Model:
    try:
        coefficients = refitted(problem, best)
    except KeyboardInterrupt:
        coefficients = best.coefficients
    terms = [Term(float(c), problem.candidates[i].factors) for c, i in zip(coefficients, best.chosen, strict=True)]
    return Model("polynomial_narx", sampling, tuple(terms), problem.envelope, problem.force_envelope)


def _held_out(whole: Sequence[Series], split: float) -> list[Series]:
    """Return the rest of each series after `split`, where it is long enough to be judged."""
    rest = [series.part(split, 1.0) for series in whole] if split < 1.0 else []
    return [series for series in rest if series.scored.sum() >= LEAST_SCORED]


def _origin(recording: Recording) -> dict[str, str]:
    return {"recording": recording.name, "sha256": recording.sha256}
