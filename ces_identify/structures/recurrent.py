"""Recurrent networks at the desk: fit and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.polynomial.search_limits import Listener, SearchResult, run_starts
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit
from ces_identify.trained.recurrent_training import RecurrentFamily, build_family, descend, train_member
from ces_identify.trained.training import build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.structures.recurrent import Recurrent
from ces_report.typesetting import ModelTable, describe_signals, four_figures, parameter_table

MEMBERS = 3
MIN_DATA_S = (
    11.0  # for 1,086 parameters of a member (racing, 6 s: 0.9 % on blocks left out, 11 % later; Dyke, 14 s: best)
)
REFIT_STEPS, REFIT_RATE = 200, 1e-2  # of AdamW, from the model's own parameters


def fit_recurrent(series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener) -> Fitted:
    """Return the best model; raises CesError if no start gives one. A fit of one start has one network."""
    training, limits = build_training(series, options.weight), options.limits
    family = build_family(training, sampling.rate_Hz)
    starts = replace(limits, starts=min(limits.starts, MEMBERS))
    results = run_starts(starts, partial(train_member, family, limits, listener))
    results = [result for result in results if np.isfinite(result.cost)]
    if not results:
        raise CesError("no start of the recurrent fit gave a model; give more time, starts or data")
    mean, members = _best_mean(family, results)
    listener(mean)
    make = partial(_build_model, family, sampling)
    model = make(members)
    how = {
        "method": "AdamW on the free-run error of windows, the mean of several fits",
        "parameters": len(mean.coefficients),
    }
    certified = replace(model, certificate=model.certify().to_mapping())
    return Fitted(certified, [mean, *results[1:]], how, partial(_refit, family, members, make))


def _best_mean(family: RecurrentFamily, results: Sequence[SearchResult]) -> tuple[SearchResult, list[F]]:
    """Return the mean of the best one, two, ... networks with the lowest cost on the selection ticks, and these."""
    training, members = family.training, [result.coefficients for result in results]
    ways = [members[: n + 1] for n in range(len(members))]
    costs = [training.cost(family.force(way), training.selection) for way in ways]
    best = int(np.argmin(costs))
    mean = replace(results[0], coefficients=np.concatenate(ways[best]), cost=costs[best], share=1.0)
    return mean, ways[best]


def _build_model(family: RecurrentFamily, sampling: Sampling, members: Sequence[F]) -> Model:
    training = family.training
    return Model(sampling, family.body(members), training.envelope, training.force_envelope)


def _refit(
    family: RecurrentFamily, members: Sequence[F], make: Callable[[Sequence[F]], Model], weights: F
) -> Model | None:
    """Return the model with parameters fitted to the weighted ticks, as `Fitted.refit` describes it."""
    kept = weights * (family.training.estimation + family.training.selection)
    found = []
    for seed, params in enumerate(members):
        *_, last = descend(family, kept, params, np.random.default_rng(seed), REFIT_STEPS, REFIT_RATE)
        found.append(last)
    return make(found)


def recurrent_table(body: Recurrent, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the decay times and frequencies of the filters, by network and stage."""
    about = (
        f"The mean of {len(body.members)} networks of linear filters with layers of tanh between them: two stages for "
        "the motion, one for the current. What a filter knows of the past fades with its decay time."
    )
    rows = [
        (
            Markup("{}, {}").format(n, name.replace("_", " ")),
            Markup("{}").format(len(stage.decay_s)),
            *(four_figures(1e3 * find(stage.decay_s)) for find in (min, max)),
            four_figures(max(map(abs, stage.frequency_Hz))),
        )
        for n, member in enumerate(body.members, 1)
        for name, stage in member.stages.items()
    ]
    heads = ("Network, stage", "Filters", "Fastest decay [ms]", "Slowest [ms]", "Highest frequency [Hz]")
    signals = {one.signal.partition("_")[0] for one in (*body.motion, *body.current)}
    return parameter_table(
        about, tuple(map(Markup, heads)), tuple(rows), describe_signals(signals, model.sampling.rate_Hz)
    )


RECURRENT = StructureKit(
    about="recurrent network that forgets",
    body=Recurrent,
    sizes=(),
    fitter=lambda sizes: fit_recurrent,
    table=recurrent_table,
    auto_work=0.25,
    auto_s=MIN_DATA_S,
)
