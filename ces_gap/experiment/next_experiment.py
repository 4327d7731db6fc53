"""What the recordings leave open, the next experiment that settles it, and its files for `ces rig` and a real rig."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from math import sqrt
from typing import Any

import numpy as np
import yaml

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.baseline.twin import Twin
from ces_gap.effects.effect import Setting
from ces_gap.errors import GapError
from ces_gap.experiment.candidates import (
    Match,
    Probe,
    Recipe,
    find_nearest,
    generate_waveforms,
    list_candidate_experiments,
    reach_of,
    refine_match,
    sample_tangents,
)
from ces_gap.inference.judgement import PARAMETERS, Judgement
from ces_gap.inference.search import EffectSearchResult
from ces_gap.trace import Trace, make_trace
from ces_identify.numerics.search import clock_s
from ces_identify.schema_files import schema_line
from ces_observer.errors import CesError
from ces_report.table import PrintedResult
from ces_report.typesetting import join_with


@dataclass(frozen=True, repr=False)
class NextExperiment(PrintedResult):
    """The next experiment: `recipe` for `ces rig`; `time_s`, `position_m`, `current_A` (n,) for its CSV file.

    `separates` are the effects that it distinguishes, `distance_N` [N] RMS the difference of their forces.
    """

    name: str
    purpose: str
    recipe: dict[str, Any]
    time_s: F
    position_m: F
    current_A: F
    separates: tuple[str, ...] = ()
    distance_N: float = 0.0


def experiment_files(experiment: NextExperiment) -> dict[str, str]:
    """Return texts by name: `next_experiment.yaml`, which `ces rig` runs, and `next_experiment.csv` for a real rig."""
    table, header = StringIO(), "time_s,position_m,current_A"
    columns = np.stack([experiment.time_s, experiment.position_m, experiment.current_A], axis=1)
    np.savetxt(table, columns, fmt=("%.3f", "%.7f", "%.4f"), delimiter=",", header=header, comments="")
    purpose = " ".join(experiment.purpose.split())
    recipe = yaml.safe_dump(experiment.recipe, sort_keys=False, allow_unicode=True)
    text = f"{schema_line('experiment')}# {purpose}\n{recipe}"
    return {"next_experiment.csv": table.getvalue(), "next_experiment.yaml": text}


Pair = tuple[Setting, Setting]

FINALISTS = 3  # experiments on which effects are evaluated again instead of along tangents
BUDGET_S = 20.0  # [s] computing time after which no further experiment is simulated


@dataclass(frozen=True)
class _Candidate:
    """An experiment, and the match of the pair that it distinguishes least."""

    recipe: Recipe
    trace: Trace
    nearest: Pair
    match: Match

    @property
    def rate(self) -> float:
        """Expected log-likelihood ratio per second."""
        return self.match.evidence / float(self.recipe["duration_s"])

    @property
    def distance(self) -> float:
        """Expected RMS of the difference between the pair's forces, but for a constant, over that of the noise."""
        return self.match.index / sqrt(max(int(self.trace.usable.sum()), 1))


def propose_experiment(
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
    plant's own simulation is a twin. `recipes` are the candidates, by default those within reach of the traces.
    Experiments that the simulation refuses are left out. Raises GapError if it refuses all, and if no experiment is
    expected to show a difference above the noise.
    """
    if not pairs:
        return None
    recipes = list_candidate_experiments(reach_of(traces)) if recipes is None else recipes
    compared = list(_compare_candidates(plant, exact or plant.simulation, recipes, pairs, noise_N, budget_s))
    best = max(_evaluate_again(plant, compared, pairs, noise_N), key=lambda t: t.rate, default=None)
    if best is None:
        raise GapError(f"the simulation refuses all {len(recipes)} candidate experiments")
    name, other = (setting.name for setting in best.nearest)
    pair, distance_N = " from ".join(map(_describe, best.nearest)), best.distance * noise_N
    size = f"{distance_N:.2g} N RMS ({best.distance:.2g} × the noise)"
    if best.distance < 1.0:
        raise GapError(
            f"none of the {len(compared)} candidate experiments that were simulated would distinguish "
            f"{pair}: the largest expected difference is {size}"
        )
    purpose = f"distinguishes {pair}: expected difference {size} over {float(best.recipe['duration_s']):.0f} s"
    waveforms = generate_waveforms(best.recipe)
    return NextExperiment(str(best.recipe["name"]), purpose, best.recipe, *waveforms, (name, other), distance_N)


def _describe(setting: Setting) -> str:
    """Return the name of an effect, of parameters those of each."""
    if setting.name == PARAMETERS:
        return join_with([p.name for p in setting.effect.parameters])
    return setting.name.replace("_", " ")


def simulate_experiment(simulation: TraceSimulator, recipe: Recipe) -> Trace:
    """Return the trace of an experiment as commanded, without noise, with the simulated force.

    Raises CesError if the simulation refuses.
    """
    seconds, position, current = generate_waveforms(recipe)
    stamps = np.round(seconds * 1e9).astype(np.int64)
    signals = {"position": ("m", position), "current": ("A", current), "force": ("N", np.zeros_like(position))}
    channels = {name: Channel(name, unit, stamps, values) for name, (unit, values) in signals.items()}
    bare = make_trace(Recording(str(recipe["name"]), channels), np.zeros_like(position))
    if isinstance(simulation, Twin):  # there is no force to start from
        return replace(bare, simulated=simulation.prepare_for(bare).recorded_force)
    return replace(bare, simulated=simulation.force(bare, bare.inputs))


def _compare_candidates(
    plant: Plant,
    simulation: TraceSimulator,
    recipes: Sequence[Recipe],
    pairs: Sequence[Pair],
    noise_N: float,
    budget_s: float,
) -> Iterator[_Candidate]:
    """Yield experiments compared along tangents until the time is up, at least one if any can run."""
    end, any_done = clock_s() + budget_s, False
    for recipe in recipes:
        if any_done and clock_s() > end:
            return
        try:
            trace = simulate_experiment(simulation, recipe)
            yield _compare_effects(plant, recipe, trace, pairs, noise_N, rerun=False)
        except CesError:
            continue
        any_done = True


def _evaluate_again(
    plant: Plant, compared: Sequence[_Candidate], pairs: Sequence[Pair], noise_N: float
) -> Iterator[_Candidate]:
    """Yield the fastest experiments with the effects evaluated again; the simulation may refuse what effects change."""
    done = 0
    for candidate in sorted(compared, key=lambda t: -t.rate):
        if done == FINALISTS:
            return
        try:
            yield _compare_effects(plant, candidate.recipe, candidate.trace, pairs, noise_N, rerun=True)
        except CesError:
            continue
        done += 1


def _compare_effects(
    plant: Plant, recipe: Recipe, trace: Trace, pairs: Sequence[Pair], noise_N: float, rerun: bool
) -> _Candidate:
    """Return the match of the nearest pair, each in the direction in which its effects are nearer."""

    def whiten(force: F) -> F:  # white noise on a force with unknown zero
        usable = force[trace.usable]
        return np.asarray((usable - usable.mean()) / noise_N)

    probe = Probe(plant, trace, whiten)
    at = {s: probe.tangent(s) for pair in pairs for s in pair}

    def match(a: Setting, b: Setting) -> Match:
        if not rerun:
            return find_nearest(at[a], [at[b]])
        return refine_match(at[a], sample_tangents(probe, at[b], at[a].size), probe.tangent)

    matches = {pair: min((match(*pair), match(*pair[::-1])), key=lambda m: m.index) for pair in pairs}
    nearest = min(pairs, key=lambda pair: matches[pair].index)
    return _Candidate(recipe, trace, nearest, matches[nearest])


def find_pairs(result: EffectSearchResult, composition: Sequence[str], judgement: Judgement) -> tuple[Pair, ...]:
    """Return the pairs of effects that an experiment should distinguish.

    They are those that the recordings cannot distinguish, an effect of the composition and each that may be the cause
    instead, or else the two that fit best. Only effects that were fitted alone can be simulated apart.
    """
    settings = {f.names[0]: f.composition.settings[0] for f in result.alone if not f.effects[0].nuisance}
    main = next((name for name in (*composition, *judgement.alternatives) if name in settings), "")
    pairs = [group[:2] for group in judgement.ties] or [(main, other) for other in judgement.alternatives]
    apart = [pair for pair in pairs if len({*pair} & settings.keys()) == 2] or [tuple(settings)[:2]]
    return tuple((settings[pair[0]], settings[pair[1]]) for pair in apart if len(pair) == 2)
