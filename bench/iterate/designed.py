"""Experiments designed by `ces iterate` against noise and sweep of the same length and limits, on the virtual rig.

Usage: python -m bench.iterate.designed [--seeds N] [--structures NAME...] [--dampers NAME...] [--processes N]
[--dry]. The table goes between the markers in docs/iterate.md.

Each model is identified from 60 s in all by the same options, and judged by its cost J on recordings that it never saw.
Beside the two, three more show where the gain comes from and where it ends: noise and sweep with a current that does
not follow the stroke, random experiments from the same family of motions and currents, and recordings of the judging
kinds themselves with other seeds (road, both sines, FM, 15 s each); these three for the first two seeds only.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed, parallel_config

from bench.iterate.usual_experiments import (
    FREE,
    PACKAGED,
    judging_recordings,
    kindred_commands,
    limits_of,
    make_rig,
    usual_commands,
)
from bench.markdown import between, markdown, replace_between
from bench.measurement import machine, print_note, verdict
from ces_identify.identification import identify
from ces_identify.recordings.recording import Recording
from ces_identify.structures.auto import default_sizes
from ces_identify.structures.registry import KITS
from ces_iterate.commands import RigCommands
from ces_iterate.design.designer import DesignTask, design_experiment
from ces_iterate.design.features import draw_features
from ces_iterate.design.information import Information
from ces_iterate.design.pool import draw_pool
from ces_iterate.loop.heat import make_power_model
from ces_iterate.loop.identification import evaluate_fresh
from ces_iterate.loop.iterate import Iterations
from ces_iterate.plan.limits import RigLimits
from ces_iterate.plan.plan import ExperimentPlan, IdentifyPlan, Plan, StopRules
from ces_observer.model import Model

PAGE = Path(__file__).resolve().parents[2] / "docs" / "iterate.md"
NAME = "designed"
TOTAL_S, EXPERIMENT_S = 60.0, 15.0
TARGET = 0.75
EXPLAINED_SEEDS = 2  # seeds with the ways that only explain
WAYS = ("noise + sweep", "free current", "random", "judges' kinds", "designed")
IDENTIFY = {
    "chambers": IdentifyPlan("chambers", time_s=60.0, starts=1, threads=1),
    "polynomial": IdentifyPlan("polynomial", time_s=60.0, starts=2, terms=20, threads=1),
}

Costs = dict[str, dict[str, float]]
"""Cost J [%] by way and by judging recording."""


@dataclass(frozen=True)
class DesignCase:
    """One comparison."""

    damper: str
    structure: str
    seed: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="seeds for each damper and structure")
    parser.add_argument("--structures", nargs="+", choices=tuple(IDENTIFY), default=list(IDENTIFY))
    parser.add_argument("--dampers", nargs="+", default=["default", "monotube"], help="default, or a kind of damper")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--dry", action="store_true", help="print the table without changing docs/")
    options = parser.parse_args()
    if not options.dry:
        between(PAGE, NAME)  # fails before the long work
    cases = [
        DesignCase(d, s, seed + 1) for s in options.structures for d in options.dampers for seed in range(options.seeds)
    ]
    results: dict[DesignCase, Costs] = {}
    with parallel_config("loky", n_jobs=options.processes, inner_max_num_threads=1):
        for case, costs, seconds in Parallel(return_as="generator_unordered")(delayed(compare)(c) for c in cases):
            results[case] = costs
            print_note(f"[{len(results):2}/{len(cases)}] {seconds:4.0f} s  {case}: ratio {_case_ratio(costs):.2f}")
    table = format_table({case: results[case] for case in cases})
    print(f"\n{table}")
    if not options.dry:
        replace_between(PAGE, NAME, table)


def compare(case: DesignCase) -> tuple[DesignCase, Costs, float]:
    """Return the costs of all ways for one case, and the seconds that it took."""
    began = time.perf_counter()
    rig, plan = make_rig(case.damper), IDENTIFY[case.structure]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)

        def record(commands: RigCommands) -> Recording:
            return rig.run(commands, folder)

        usual = usual_commands(rig, case.seed, TOTAL_S, None)
        limits = limits_of(usual, rig)
        judges = judging_recordings(rig, case.seed, record)
        experiments = {WAYS[0]: usual}
        if case.seed <= EXPLAINED_SEEDS:
            experiments |= {
                "free current": usual_commands(rig, case.seed, TOTAL_S, FREE),
                "random": random_commands(limits, case.seed),
                "judges' kinds": kindred_commands(rig, case.seed, EXPERIMENT_S),
            }
        models = {
            way: identify_quickly([record(one) for one in commands], plan, case.seed)
            for way, commands in experiments.items()
        }
        iterations = Iterations(make_plan(limits, plan, case.seed), rig, folder / "iterate")
        iterations.run()
        assert iterations.done.model is not None
        models["designed"] = iterations.done.model
        costs = {
            way: {name: evaluate_fresh(model, one).cost for name, one in judges.items()}
            for way, model in models.items()
        }
    return case, costs, time.perf_counter() - began


def identify_quickly(recordings: Sequence[Recording], plan: IdentifyPlan, seed: int) -> Model:
    """Return the model that an iteration would identify, without its band and ensemble."""
    fitter = KITS[plan.structure].fitter(default_sizes())
    return identify(recordings, (), replace(plan.options(seed), band=False), fitter=fitter).model


def make_plan(limits: RigLimits, identify: IdentifyPlan, seed: int) -> Plan:
    """Return the plan of the designed experiments."""
    stop = StopRules(budget_s=TOTAL_S)
    return Plan("bench", Path(), limits, {}, seed, ExperimentPlan(duration_s=EXPERIMENT_S), stop, identify)


def random_commands(limits: RigLimits, seed: int) -> list[RigCommands]:
    """Return experiments drawn from the same family, without a choice."""
    features = draw_features(seed)
    targets = features.at(draw_pool(limits, seed).state)
    task = DesignTask(
        limits, features, Information.none(targets.shape[1]), targets, np.ones(len(targets)),
        make_power_model(None, limits.heat),
    )  # fmt: skip
    count = round(TOTAL_S / EXPERIMENT_S)
    return [design_experiment(task, f"random {k}", EXPERIMENT_S, 1000 * seed + k, 1) for k in range(count)]


def format_table(results: Mapping[DesignCase, Costs]) -> str:
    """Return medians over the seeds for each damper, structure and recording, and the verdict."""
    parts: list[str] = []
    ratios: list[tuple[str, str, bool, float]] = []
    for structure in dict.fromkeys(case.structure for case in results):
        rows = [["damper", "stroke, current", *(f"{way} J %" for way in WAYS), "designed / noise + sweep"]]
        for damper in dict.fromkeys(case.damper for case in results):
            some = [costs for case, costs in results.items() if (case.damper, case.structure) == (damper, structure)]
            if not some:
                continue
            table = [_row(damper, name, some) for name in some[0][WAYS[0]]]
            rows += [row for row, _ in table]
            ratios += [(structure, damper, PACKAGED in row[1], ratio) for row, ratio in table]
        parts.append(f"Structure `{structure}`:\n\n{markdown(rows)}")
    seeds = len({case.seed for case in results})
    summary = [_summary(ratios, s, seeds) for s in dict.fromkeys(structure for structure, *_ in ratios)]
    return "\n\n".join([*summary, *parts, machine()])


def _row(damper: str, name: str, some: Sequence[Costs]) -> tuple[list[str], float]:
    medians = [float(np.median([costs[way][name] for costs in some if way in costs])) for way in WAYS]
    ratio = float(np.median([costs["designed"][name] / costs[WAYS[0]][name] for costs in some]))
    return [damper, name, *(f"{value:.2f}" for value in medians), f"{ratio:.2f}"], ratio


def _summary(ratios: Sequence[tuple[str, str, bool, float]], structure: str, seeds: int) -> str:
    mine = [(damper, packaged, ratio) for one, damper, packaged, ratio in ratios if one == structure]
    median = float(np.median([ratio for *_, ratio in mine]))
    parts = {damper: [ratio for d, _, ratio in mine if d == damper] for damper in dict.fromkeys(d for d, *_ in mine)}
    parts |= {"packaged currents only": [ratio for _, packaged, ratio in mine if packaged]}
    each = ", ".join(f"{name} {np.median(some):.2f}" for name, some in parts.items())
    worse = sum(ratio > 1.0 for *_, ratio in mine)
    return (
        f"`{structure}`, {seeds} seeds: {median:.2f} times the cost, median over {len(mine)} rows ({each}); "
        f"target {TARGET}: {verdict(median, TARGET)}. Higher than noise + sweep in {worse} rows."
    )


def _case_ratio(costs: Costs) -> float:
    return float(np.median([costs["designed"][name] / usual for name, usual in costs[WAYS[0]].items()]))


if __name__ == "__main__":
    main()
