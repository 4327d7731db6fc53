"""The experiment that would tell most: each on the menu is simulated, and the effects in question are compared there.

What counts is the evidence a second of rig time is expected to give between the two effects hardest to tell apart,
each in turn taken as true at its fitted values while the other is fitted anew to what it would then do.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.effects.effect import Setting
from ces_gap.experiment.candidate_experiments import Recipe, list_candidate_experiments, reach_of
from ces_gap.experiment.experiment_files import NextExperiment
from ces_gap.experiment.indistinguishable import EVIDENCE
from ces_gap.experiment.matching import Match, nearest, refine_match
from ces_gap.experiment.signatures import Probe, Tangent, sample_tangents
from ces_gap.experiment.waveforms import generate_waveforms
from ces_gap.trace import Trace, make_trace
from ces_identify.recordings.recording import Channel, Recording
from ces_observer.errors import CesError

F = NDArray[np.float64]
TraceWhitening = Callable[[Trace], Callable[[F], F]]  # a trace -> how forces (n,) on it are whitened
Pair = tuple[Setting, Setting]

FINALISTS = 3  # experiments for which the effects are run again rather than followed along tangents
BUDGET_S = 20.0  # [s] of computing after which the experiments simulated so far have to do


@dataclass(frozen=True)
class _Candidate:
    """An experiment, and the match of the pair that it tells apart least."""

    recipe: Recipe
    trace: Trace
    worst: Pair
    match: Match

    @property
    def rate(self) -> float:
        """Expected log-likelihood ratio a second."""
        return self.match.evidence / float(self.recipe["duration_s"])


def choose_next_experiment(
    plant: Plant,
    traces: Sequence[Trace],
    pairs: Sequence[Pair],
    noise_N: float,
    exact: TraceSimulator | None = None,
    recipes: Sequence[Recipe] | None = None,
    budget_s: float = BUDGET_S,
) -> NextExperiment | None:
    """Return the experiment that tells the `pairs` of fitted effects apart fastest; None without pairs or simulation.

    Noise counts as white of `noise_N` RMS on a force whose zero is unknown. `exact` is asked once for each experiment,
    where the plant's own simulation is a surrogate that knows differences best. `recipes` are those to choose from, by
    default the menu within reach of the traces. An experiment that the simulation refuses is left out.
    """
    if not pairs:
        return None
    whiten = make_white_noise_whitening(noise_N)
    choice = list_candidate_experiments(reach_of(traces)) if recipes is None else recipes
    tried = list(_compare_candidates(plant, exact or plant.simulation, choice, pairs, whiten, budget_s))
    if not tried:
        return None
    finalists = sorted(tried, key=lambda t: -t.rate)[:FINALISTS]
    again = [_compare_effects(plant, t.recipe, t.trace, pairs, whiten, rerun=True) for t in finalists]
    return _make_next_experiment(max(again, key=lambda t: t.rate), noise_N)


def make_white_noise_whitening(noise_N: float) -> TraceWhitening:
    """Return the whitening for white noise of this RMS [N] on a force whose zero is unknown."""

    def whitening(trace: Trace) -> Callable[[F], F]:
        def whiten(force: F) -> F:
            kept = force[trace.usable]
            return np.asarray((kept - kept.mean()) / noise_N)

        return whiten

    return whitening


def simulate_experiment(simulation: TraceSimulator, recipe: Recipe) -> Trace:
    """Return the trace of an experiment as commanded, without noise, with the force the simulation gives.

    Raises CesError if the simulation refuses.
    """
    seconds, position, current = generate_waveforms(recipe)
    stamps = np.round(seconds * 1e9).astype(np.int64)
    given = {"position": ("m", position), "current": ("A", current), "force": ("N", np.zeros_like(position))}
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in given.items()}
    bare = make_trace(Recording(str(recipe["name"]), channels), np.zeros_like(position))
    return replace(bare, simulated=_anew(simulation, bare))


def _anew(simulation: TraceSimulator, trace: Trace) -> F:
    """Return the force [N] (n,) on a trace that holds no simulated force yet."""
    if isinstance(simulation, Surrogate):
        features = simulation.dictionary.features(trace, trace.inputs, np.zeros(len(trace)))
        return np.asarray(features @ simulation.weights)
    return simulation.force(trace, trace.inputs)


def _compare_candidates(
    plant: Plant,
    simulation: TraceSimulator,
    recipes: Sequence[Recipe],
    pairs: Sequence[Pair],
    seen: TraceWhitening,
    budget_s: float,
) -> Iterator[_Candidate]:
    """Yield the experiments compared along tangents until the budget is spent, at least one if any can run."""
    end, some = time.monotonic() + budget_s, False
    for recipe in recipes:
        if some and time.monotonic() > end:
            return
        try:
            trace = simulate_experiment(simulation, recipe)
            yield _compare_effects(plant, recipe, trace, pairs, seen, rerun=False)
        except CesError:
            continue
        some = True


def _compare_effects(
    plant: Plant, recipe: Recipe, trace: Trace, pairs: Sequence[Pair], seen: TraceWhitening, rerun: bool
) -> _Candidate:
    whiten = seen(trace)
    probe = Probe(plant, [trace], lambda _, force: whiten(force))
    at = {s: probe.tangent(s) for pair in pairs for s in pair}
    matches = {pair: _match_pair(probe, at, pair, rerun) for pair in pairs}
    worst = min(pairs, key=lambda pair: matches[pair].index)
    return _Candidate(recipe, trace, worst, matches[worst])


def _match_pair(probe: Probe, at: dict[Setting, Tangent], pair: Pair, rerun: bool) -> Match:
    """Return the match of a pair: that way round in which the one comes nearer to the other."""
    found = []
    for a, b in (pair, pair[::-1]):
        if rerun:
            found.append(refine_match(at[a], sample_tangents(probe, at[b], at[a].size), probe.tangent))
        else:
            found.append(nearest(at[a], [at[b]]))
    return min(found, key=lambda match: match.index)


def _make_next_experiment(best: _Candidate, noise_N: float) -> NextExperiment:
    seconds, position, current = generate_waveforms(best.recipe)
    names = best.worst[0].name, best.worst[1].name
    return NextExperiment(
        name=str(best.recipe["name"]),
        purpose=_purpose(best, names, noise_N),
        recipe=_plain(best.recipe),
        time_s=seconds,
        position_m=position,
        current_A=current,
        separates=names,
        distance_N=best.match.rms_N,
    )


def _purpose(best: _Candidate, names: tuple[str, str], noise_N: float) -> str:
    difference, seconds = best.match.rms_N, float(best.recipe["duration_s"])
    expected = (
        f"expected difference {difference:.2g} N RMS, {difference / noise_N:.2g} × the noise, over {seconds:.0f} s"
    )
    told = f"tells {names[0]} from {names[1]}: {expected}"
    runs = ceil(EVIDENCE / max(best.match.evidence, 1e-9))
    if runs == 1:
        return told
    if runs > 20:
        return f"{told}; too little: nothing on the menu tells them apart within the range of the recordings"
    return f"{told}; to be repeated {runs} times"


def _plain(recipe: Recipe) -> dict[str, Any]:
    return {**recipe, "stroke": dict(recipe["stroke"]), "current": dict(recipe["current"])}
