"""Gated experts at the desk: fit and report. A model forgets its past within a stated time by its form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import log

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.polynomial.search_limits import Listener, run_starts
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit
from ces_identify.trained.experts_training import ExpertsFit, refit, train_experts
from ces_identify.trained.training import Lags, build_regressors, build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.options import Option
from ces_observer.proof.certificate import largest_gain
from ces_observer.structures.experts import MAX_EXPERTS, Experts
from ces_observer.structures.lagged_signals import longest_lags
from ces_observer.structures.mixture import Mixture, WeightedModel
from ces_report.typesetting import ModelTable, describe_signals, four_figures, parameter_table, signal_symbol

LAGS_S = (0.0, 1e-3, 3e-3, 7e-3, 15e-3)  # of speed and current (Dyke: 15 %; with the last four ticks of 3 kHz 20 %),
LEAST_LAGS = 4  # and at least so many (Keio, 200 Hz: 9 %, with three 11 %)
DECAY = 3e-6  # [(J / 100)^2] cost of a squared weight
STARTS, MEMBERS, ALIKE = 6, 3, 1.2  # starts at most; of these in the mean, within this ratio of the best's cost
STARTS_TICKS = 120_000  # of all starts together; there are MEMBERS at least
ROUNDING = 1e-12  # relative, of the limit of a gain


def choose_lags(rate_Hz: float) -> tuple[float, ...]:
    """Return the lags [s] of the inputs: those of LAGS_S in whole ticks, or the first ticks if these are too few."""
    ticks = sorted({round(lag * rate_Hz) for lag in LAGS_S})
    return tuple(k / rate_Hz for k in (ticks if len(ticks) >= LEAST_LAGS else range(LEAST_LAGS)))


def fit_experts(
    count: int, series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener
) -> Fitted:
    """Return the mean of the best starts; raises CesError if no start gives a model."""
    training = build_training(series, options.weight)
    lags_s = choose_lags(sampling.rate_Hz)
    past, *inputs = build_regressors(training, Lags((1,), lags_s, lags_s), sampling.rate_Hz)
    limit = largest_gain(options.forget, *longest_lags((*inputs, past)), sampling.rate_Hz) * (1.0 - ROUNDING)
    family = ExpertsFit(training, (*inputs, past), count, limit, DECAY)
    starts = min(options.limits.starts, STARTS, max(MEMBERS, STARTS_TICKS // len(training.measured)))
    limits = replace(options.limits, starts=starts)
    results = run_starts(limits, partial(train_experts, family, limits, listener))
    best = [one for one in results if one.cost <= ALIKE * results[0].cost and np.isfinite(one.cost)][:MEMBERS]
    if not best:
        raise CesError("no start of the experts' fit gave a model; give more time, starts or data")
    members = [one.coefficients for one in best]
    mean = np.mean([family.force(params) for params in members], axis=0)
    results[0] = replace(results[0], cost=training.cost(mean, training.selection))
    listener(results[0])
    make = partial(_build_model, family, sampling)
    model = make([refit(family, one, training.estimation + training.selection) for one in members])
    how = {
        "method": "Levenberg-Marquardt on the free-run error, from free gains into bounded ones; the mean of the best",
        "parameters": sum(map(len, members)),
    }
    certified = replace(model, certificate=model.certify().to_mapping())
    return Fitted(certified, results, how, partial(_refit, family, members, make))


def _build_model(family: ExpertsFit, sampling: Sampling, members: Sequence[F]) -> Model:
    """Return the mean of members, or the only one."""
    training = family.training
    bodies = [family.body(params) for params in members]
    mean = Mixture(tuple(WeightedModel(1.0 / len(bodies), body, training.force_envelope) for body in bodies))
    return Model(sampling, mean if len(bodies) > 1 else bodies[0], training.envelope, training.force_envelope)


def _refit(family: ExpertsFit, members: Sequence[F], make: Callable[[Sequence[F]], Model], weights: F) -> Model:
    """Return the model with parameters fitted to the weighted ticks, as `Fitted.refit` describes it."""
    kept = weights * (family.training.estimation + family.training.selection)
    return make([refit(family, params, kept) for params in members])


def experts_table(body: Experts, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the experts: the gain of each input, and the time in which a past force fades."""
    about = (
        f"{len(body.experts)} experts, each a recursion of its own, blended by shares that depend on the inputs alone. "
        "Numbers: force [N] for a change of an input by one standard deviation, without the bend."
    )
    heads = (Markup("Expert"), *(signal_symbol(r.signal, r.lag) for r in body.inputs), Markup("Fades in [ms]"))
    rows = []
    for number, one in enumerate(body.experts, 1):
        slowest = max(one.past, one.past + one.past_bend)
        fades = 1e3 / (-log(slowest) * model.sampling.rate_Hz) if 0.0 < slowest < 1.0 else 0.0
        forces = (four_figures(body.scale_N * weight) for weight in one.linear[:-1])
        rows.append((Markup("{}").format(number), *forces, four_figures(fades)))
    symbols = describe_signals((r.signal for r in body.inputs), model.sampling.rate_Hz)
    return parameter_table(about, heads, tuple(rows), symbols)


def _check_count(text: str) -> object:
    if not text.isdecimal() or not 1 <= int(text) <= MAX_EXPERTS:
        raise ValueError(f"{text!r} is not a whole number from 1 to {MAX_EXPERTS}")
    return text


COUNT = Option(
    "experts", "6", "number of gated experts", form=f"1 to {MAX_EXPERTS}", check_text=_check_count, metavar="N"
)
EXPERTS = StructureKit(
    about="gated experts that forget",
    body=Experts,
    sizes=(COUNT,),
    fitter=lambda sizes: partial(fit_experts, int(sizes["experts"])),
    table=experts_table,
    auto_work=1.0,
)
