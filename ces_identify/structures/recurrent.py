"""Recurrent networks at the desk: AdamW on the free-run error of windows drawn at random, and report.

A fit has a fixed number of steps, so that it depends on data and seed alone. In its second half the free run on the
selection ticks is computed now and then, and the parameters with the lowest cost are kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf

import numpy as np

from ces_data.arrays import F, I
from ces_identify.limits import ChoiceLimits
from ces_identify.numerics.search import STEPS_DONE, Listener, SearchResult, SearchStart, clock_s, run_starts
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit, require_models
from ces_identify.structures.recurrent_network import (
    FILTERS,
    RecurrentFamily,
    build_family,
    new_states,
    run_member,
    run_member_back,
)
from ces_identify.training import Training, build_training
from ces_observer.model import Model, Sampling
from ces_observer.structures.recurrent import Recurrent
from ces_report.table import Section, parameter_section
from ces_report.typesetting import describe_signals, four_figures

STEPS = 5000  # of a fit in the default work
WARM_STEPS = 50  # over which the rate rises
RATE = 2.5e-2  # of the first step after these; falls with a cosine to 0
DECAY = 0.03  # of weights, a step and rate
MEAN_BETA, SQUARE_BETA, MIN_ROOT = 0.9, 0.999, 1e-8  # of AdamW (Loshchilov & Hutter 2019)
MAX_GRADIENT = 1.0
WINDOW_S, MIN_WINDOW, MAX_WINDOW = 0.27, 400, 800  # length of a window, and its limits [ticks]
UNSCORED = 0.25  # of a window, at its beginning, without a weight
STEP_TICKS, MIN_LANES = 4800, 8  # of all windows of a step, and least number of these
REST_WEIGHT = 0.1  # of a damper at rest, for which no recording is needed
CHECKS = 12  # free runs on the selection ticks, evenly spaced in the second half
POLL_STEPS = 20  # between two looks at the clock
HOPELESS = "far from the best of other structures"


MEMBERS = 3
REFIT_STEPS, REFIT_RATE = 200, 1e-2  # of AdamW, from the model's own parameters
REFIT_SHARE, TIMED_STEPS = 0.06, 10  # of a time limit, for each refit of the band; steps that show how long one takes


@dataclass(frozen=True)
class Windows:
    """Windows of `ticks` that start at `starts` (n,), `lanes` of them in a step; `weights` are 1 in the mean."""

    starts: I
    ticks: int
    unscored: int
    lanes: int
    weights: F

    @classmethod
    def of(cls, training: Training, rate_Hz: float, weights: F) -> Windows:
        """Return the windows with enough weight; the longest segment limits their length."""
        ticks = min(max(MIN_WINDOW, round(WINDOW_S * rate_Hz)), MAX_WINDOW, int(np.diff(training.segments).max()))
        unscored = round(UNSCORED * ticks)
        counted = np.concatenate([[0], np.cumsum(weights > 0.0)])
        begins = np.concatenate([np.arange(a, max(a, b - ticks + 1)) for a, b in training.segments])
        share = (counted[begins + ticks] - counted[begins + unscored]) / (ticks - unscored)
        starts = begins[share >= min(0.5, float(share.max()))]
        lanes = max(MIN_LANES, STEP_TICKS // ticks)
        return cls(starts, ticks, unscored, lanes, weights / weights[weights > 0.0].mean())

    def draw(self, random: np.random.Generator) -> tuple[I, F]:
        """Return ticks and weights (ticks, lanes + 1) of some windows, the weights over the number of scored ticks.

        The last one stays at one tick: it stands for a damper at rest, which recordings may not hold.
        """
        at = random.choice(self.starts, self.lanes + 1) + np.arange(self.ticks)[:, None]
        at[:, -1] = at[0, -1]
        weights = self.weights[at] / (self.lanes * (self.ticks - self.unscored))
        weights[:, -1] = REST_WEIGHT / (self.ticks - self.unscored)
        weights[: self.unscored] = 0.0
        return at, weights


def descend(
    family: RecurrentFamily, weights: F, params: F, random: np.random.Generator, steps: int, rate: float = RATE
) -> Iterator[F]:
    """Yield the parameters after each step of AdamW on the weighted squared error of windows."""
    t = family.training
    windows, measured = Windows.of(t, family.rate_Hz, weights), t.measured / t.scale_N
    at_rest = family.at_rest(weights)
    mean, square = np.zeros(len(params)), np.zeros(len(params))
    motion, current = family.rows
    for k in range(1, steps + 1):
        at, share = windows.draw(random)
        arrays = family.arrays(params)
        moving, wanted = motion[:, at], measured[at]
        moving[:3, :, -1], wanted[:, -1] = family.still[:, None], at_rest[at[:, -1]]
        force, traces = run_member(arrays, moving, current[:, at], new_states(arrays, windows.lanes + 1))
        back = run_member_back(arrays, traces, 2.0 * share * (force - wanted))
        gradient = family.gradient(params, back)
        gradient *= min(1.0, MAX_GRADIENT / max(float(np.linalg.norm(gradient)), 1e-300))
        mean += (1.0 - MEAN_BETA) * (gradient - mean)
        square += (1.0 - SQUARE_BETA) * (gradient**2 - square)
        root = np.sqrt(square / (1.0 - SQUARE_BETA**k)) + MIN_ROOT
        now = rate * min(1.0, k / WARM_STEPS) * 0.5 * (1.0 + np.cos(np.pi * k / steps))
        params = params - now * (mean / (1.0 - MEAN_BETA**k) / root + DECAY * family.decayed * params)
        yield params


def train_member(family: RecurrentFamily, start: SearchStart) -> SearchResult:
    """Return the parameters with the lowest cost on the selection ticks that a start met."""
    random, training, steps, ended = start.random, family.training, max(2, round(STEPS * start.limits.work)), ""
    checks = set(np.linspace(steps // 2, steps, CHECKS, dtype=int).tolist())
    for k, params in enumerate(descend(family, training.estimation, family.start(random), random, steps), 1):
        ended = start.reason_to_end() if k % POLL_STEPS == 0 else ""
        if ended or k in checks:
            cost = training.cost(family.force([params]), training.selection)
            if cost < start.best.cost:
                start.keep(chosen=np.arange(FILTERS), coefficients=params, cost=cost, trials=k, share=k / steps)
            ended = ended or (HOPELESS if start.best.cost > start.limits.hopeless else "")
        if ended:
            break
    return replace(start.best, ended=ended or STEPS_DONE)


def fit_recurrent(series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener) -> Fitted:
    """Return the best model; raises CesError if no start gives one. A fit of one start has one network."""
    training, limits = build_training(series, options.weight), options.limits
    family = build_family(training, sampling.rate_Hz)
    starts = replace(limits, starts=min(limits.starts, MEMBERS))
    listener("training recurrent networks")
    results = require_models(run_starts(starts, listener, partial(train_member, family)), RECURRENT.option)
    mean, members = _best_mean(family, results)
    listener(mean)
    how = {
        "method": "AdamW on the free-run error of windows, the mean of several fits",
        "parameters": len(mean.coefficients),
    }
    refit = partial(_refit_members, family, sampling, members, REFIT_SHARE * limits.time)
    return Fitted(_build_model(family, sampling, members), [mean, *results[1:]], how, refit)


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
    model = Model(sampling, family.body(members), training.envelope, training.force_envelope)
    return replace(model, certificate=model.certify().to_mapping())


def _refit_members(
    family: RecurrentFamily, sampling: Sampling, members: Sequence[F], limit_s: float, weights: F
) -> Model:
    """Return the model with parameters fitted to the weighted ticks, as `Fitted.refit` describes it.

    A time limit leaves as many steps as it has room for.
    """
    kept = weights * family.training.everything
    steps, refitted = REFIT_STEPS, []
    if limit_s < inf:
        began_s = clock_s()
        for _ in descend(family, kept, members[0], np.random.default_rng(0), TIMED_STEPS, REFIT_RATE):
            step_s = (clock_s() - began_s) / TIMED_STEPS
        steps = max(TIMED_STEPS, min(REFIT_STEPS, round(limit_s / (step_s * len(members)))))
    for seed, params in enumerate(members):
        *_, last = descend(family, kept, params, np.random.default_rng(seed), steps, REFIT_RATE)
        refitted.append(last)
    return _build_model(family, sampling, refitted)


def recurrent_table(body: Recurrent, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the decay times and frequencies of the filters, by network and stage."""
    about = (
        f"The mean of {len(body.members)} networks of linear filters with layers of tanh between them: two stages for "
        "the motion, one for the current. What a filter knows of the past fades with its decay time."
    )
    rows = [
        (
            f"{n}, {name.replace('_', ' ')}",
            str(len(stage.decay_s)),
            *(four_figures(1e3 * find(stage.decay_s)) for find in (min, max)),
            four_figures(max(map(abs, stage.frequency_Hz))),
        )
        for n, member in enumerate(body.members, 1)
        for name, stage in member.stages.items()
    ]
    heads = ("Network, stage", "Filters", "Fastest decay [ms]", "Slowest [ms]", "Highest frequency [Hz]")
    signals = {scaled.signal.partition("_")[0] for scaled in (*body.motion, *body.current)}
    return parameter_section(about, heads, rows, describe_signals(signals, model.sampling.rate_Hz))


RECURRENT = StructureKit(
    about="recurrent network that forgets",
    body=Recurrent,
    sizes=(),
    fitter=lambda sizes: fit_recurrent,
    table=recurrent_table,
    auto_work=0.25,
    auto_s=ChoiceLimits.RECURRENT_S,
)
