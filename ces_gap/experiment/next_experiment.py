"""Choice of the next experiment: each candidate is simulated, and the effects in question are compared on it.

The criterion is the expected evidence per second of rig time between the two effects that are hardest to distinguish:
each in turn is true at its fitted values, and the other is refitted to the force that results.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.effects.effect import Setting
from ces_gap.errors import GapError
from ces_gap.experiment.candidate_experiments import Recipe, list_candidate_experiments, reach_of
from ces_gap.experiment.experiment_files import NextExperiment
from ces_gap.experiment.matching import Match, find_nearest, refine_match
from ces_gap.experiment.signatures import Probe, Tangent, sample_tangents
from ces_gap.experiment.waveforms import generate_waveforms
from ces_gap.trace import F, Trace, make_trace
from ces_identify.recordings.recording import Channel, Recording
from ces_observer.errors import CesError

TraceWhitening = Callable[[Trace], Callable[[F], F]]  # trace -> whitening of forces (n,) on it
Pair = tuple[Setting, Setting]

FINALISTS = 3  # experiments on which effects are evaluated again instead of along tangents
BUDGET_S = 20.0  # [s] computing time after which no further experiment is simulated


@dataclass(frozen=True)
class _Candidate:
    """An experiment, and the match of the pair that it distinguishes least."""

    recipe: Recipe
    trace: Trace
    worst: Pair
    match: Match

    @property
    def rate(self) -> float:
        """Expected log-likelihood ratio per second."""
        return self.match.evidence / float(self.recipe["duration_s"])

    @property
    def distance(self) -> float:
        """Expected RMS of the difference between the pair's forces, but for a constant, over that of the noise."""
        return self.match.index / sqrt(max(int(self.trace.usable.sum()), 1))


def choose_next_experiment(
    plant: Plant,
    traces: Sequence[Trace],
    pairs: Sequence[Pair],
    noise_N: float,
    exact: TraceSimulator | None = None,
    recipes: Sequence[Recipe] | None = None,
    budget_s: float = BUDGET_S,
) -> NextExperiment | None:
    """Return the experiment that distinguishes the `pairs` of fitted effects fastest, None without pairs.

    The noise is white, of `noise_N` RMS, on a force with unknown zero. `exact` runs once for each experiment if the
    plant's own simulation is a surrogate. `recipes` are the candidates, by default those within reach of the traces.
    Experiments that the simulation refuses are left out. Raises GapError if it refuses all, and if no experiment is
    expected to show a difference above the noise.
    """
    if not pairs:
        return None
    whiten = make_white_noise_whitening(noise_N)
    recipes = list_candidate_experiments(reach_of(traces)) if recipes is None else recipes
    compared = list(_compare_candidates(plant, exact or plant.simulation, recipes, pairs, whiten, budget_s))
    best = max(_evaluate_again(plant, compared, pairs, whiten), key=lambda t: t.rate, default=None)
    if best is None:
        raise GapError(f"the simulation refuses all {len(recipes)} candidate experiments")
    if best.distance < 1.0:
        raise GapError(_describe_hopeless(best, len(compared), noise_N))
    return _make_next_experiment(best, noise_N)


def make_white_noise_whitening(noise_N: float) -> TraceWhitening:
    """Return the whitening for white noise of this RMS [N] on a force with unknown zero."""

    def whitening(trace: Trace) -> Callable[[F], F]:
        def whiten(force: F) -> F:
            usable = force[trace.usable]
            return np.asarray((usable - usable.mean()) / noise_N)

        return whiten

    return whitening


def simulate_experiment(simulation: TraceSimulator, recipe: Recipe) -> Trace:
    """Return the trace of an experiment as commanded, without noise, with the simulated force.

    Raises CesError if the simulation refuses.
    """
    seconds, position, current = generate_waveforms(recipe)
    stamps = np.round(seconds * 1e9).astype(np.int64)
    signals = {"position": ("m", position), "current": ("A", current), "force": ("N", np.zeros_like(position))}
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in signals.items()}
    bare = make_trace(Recording(str(recipe["name"]), channels), np.zeros_like(position))
    return replace(bare, simulated=_simulate(simulation, bare))


def _simulate(simulation: TraceSimulator, trace: Trace) -> F:
    """Return the force [N] (n,) on a trace that has no simulated force yet."""
    if isinstance(simulation, Surrogate):
        return simulation.predict(trace, trace.inputs)
    return simulation.force(trace, trace.inputs)


def _compare_candidates(
    plant: Plant,
    simulation: TraceSimulator,
    recipes: Sequence[Recipe],
    pairs: Sequence[Pair],
    whitening: TraceWhitening,
    budget_s: float,
) -> Iterator[_Candidate]:
    """Yield experiments compared along tangents until the time is up, at least one if any can run."""
    end, any_done = time.monotonic() + budget_s, False
    for recipe in recipes:
        if any_done and time.monotonic() > end:
            return
        try:
            trace = simulate_experiment(simulation, recipe)
            yield _compare_effects(plant, recipe, trace, pairs, whitening, rerun=False)
        except CesError:
            continue
        any_done = True


def _evaluate_again(
    plant: Plant, compared: Sequence[_Candidate], pairs: Sequence[Pair], whitening: TraceWhitening
) -> Iterator[_Candidate]:
    """Yield the fastest experiments with the effects evaluated again; the simulation may refuse what effects change."""
    done = 0
    for candidate in sorted(compared, key=lambda t: -t.rate):
        if done == FINALISTS:
            return
        try:
            yield _compare_effects(plant, candidate.recipe, candidate.trace, pairs, whitening, rerun=True)
        except CesError:
            continue
        done += 1


def _compare_effects(
    plant: Plant, recipe: Recipe, trace: Trace, pairs: Sequence[Pair], whitening: TraceWhitening, rerun: bool
) -> _Candidate:
    whiten = whitening(trace)
    probe = Probe(plant, [trace], lambda _, force: whiten(force))
    at = {s: probe.tangent(s) for pair in pairs for s in pair}
    matches = {pair: _match_pair(probe, at, pair, rerun) for pair in pairs}
    worst = min(pairs, key=lambda pair: matches[pair].index)
    return _Candidate(recipe, trace, worst, matches[worst])


def _match_pair(probe: Probe, at: dict[Setting, Tangent], pair: Pair, rerun: bool) -> Match:
    """Return the match of a pair in the direction in which they are nearer."""

    def match(a: Setting, b: Setting) -> Match:
        if not rerun:
            return find_nearest(at[a], [at[b]])
        return refine_match(at[a], sample_tangents(probe, at[b], at[a].size), probe.tangent)

    return min((match(*pair), match(*pair[::-1])), key=lambda m: m.index)


def _make_next_experiment(best: _Candidate, noise_N: float) -> NextExperiment:
    seconds, position, current = generate_waveforms(best.recipe)
    return NextExperiment(
        name=str(best.recipe["name"]),
        purpose=_purpose(best, noise_N),
        recipe=best.recipe,
        time_s=seconds,
        position_m=position,
        current_A=current,
        separates=(best.worst[0].name, best.worst[1].name),
        distance_N=best.distance * noise_N,
    )


def _purpose(best: _Candidate, noise_N: float) -> str:
    seconds = float(best.recipe["duration_s"])
    return f"distinguishes {_name_pair(best)}: expected difference {_size(best, noise_N)} over {seconds:.0f} s"


def _describe_hopeless(best: _Candidate, count: int, noise_N: float) -> str:
    return (
        f"none of the {count} candidate experiments that were simulated would distinguish "
        f"{_name_pair(best)}: the largest expected difference is {_size(best, noise_N)}"
    )


def _name_pair(best: _Candidate) -> str:
    first, second = (setting.name.replace("_", " ") for setting in best.worst)
    return f"{first} from {second}"


def _size(best: _Candidate, noise_N: float) -> str:
    return f"{best.distance * noise_N:.2g} N RMS ({best.distance:.2g} × the noise)"
