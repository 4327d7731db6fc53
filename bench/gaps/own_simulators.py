"""Diagnoses of users' own simulators: parameters wrong, an effect missing, both, or neither; how many are found.

    python -m bench.gaps.own_simulators [--seed N] [--kinds knee bouc_wen chamber] [--cases wrong missing both none]

Each case draws which parameters are off (by 15 to 60 %), which effect the simulator lacks, strokes and noise. `exact`:
the verdict names what is true and nothing else; `tie`: it is among what is printed as explaining as much.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bench.gaps.users_dampers import SIMULATORS, record
from bench.markdown import markdown
from ces_gap.api import diagnose
from ces_gap.diagnosis import NAMED, NO_GAP, Diagnosis, Explanation
from ces_gap.effects.effect import Composition
from ces_gap.effects.library import library
from ces_gap.grid import rms
from ces_gap.inference.judgement import PARAMETERS
from ces_gap.inference.verdict import TIMING
from ces_gap.pipeline import DiagnoseOptions
from ces_identify.simulations.simulation import FunctionSimulation

EFFECTS = {
    "friction": ("friction_N", 12.0, 30.0),
    "valve_lag": ("lag_s", 0.005, 0.010),
    "inertia": ("mass_kg", 1.0, 2.5),
}  # argument of `record` and range of each effect
PLAN = {
    "wrong": ((1, 0), (1, 0), (2, 0), (2, 0)),
    "missing": ((0, 1), (0, 1)),
    "both": ((1, 1), (2, 1)),
    "none": ((0, 0),),
}  # numbers of parameters that are off and of missing effects, of each case of a group
EXACT, TIE, FALSE, UNSURE, OTHER = "exact", "tie", "wrong effect named", "wrong effect, unsure", "not all"
EFFECTS_OF_LIBRARY = {effect.name for effect in library()}
MIN_GAP_N = 8.0  # of each parameter that is off
SECONDS = 12.0


@dataclass(frozen=True)
class Case:
    """A user's simulator, the true values of its parameters that are off, and the effect that it lacks."""

    kind: str
    group: str
    values: dict[str, float]
    effect: str
    size: float
    seed: int

    @property
    def truth(self) -> frozenset[str]:
        """The names of all that is wrong."""
        return frozenset((*self.values, *([self.effect] if self.effect else [])))


@dataclass(frozen=True)
class Outcome:
    """How a case ended: its `result`, and of the wrong parameters' intervals, whether each holds the truth."""

    case: Case
    result: str
    named: frozenset[str]
    holds: tuple[bool, ...]
    sentence: str
    seconds: float

    def __str__(self) -> str:
        """Return the outcome on two lines."""
        truth = ", ".join([*(f"{n} {v:.3g}" for n, v in self.case.values.items()), *filter(None, [self.case.effect])])
        named = ", ".join(sorted(self.named)) or "nothing"
        head = f"{self.case.kind}, {truth or 'right'}: {self.result}, {named} ({self.seconds:.0f} s)"
        return f"{head}\n  {self.sentence}"


def draw_cases(kinds: Sequence[str], groups: Sequence[str], seed: int) -> Iterator[Case]:
    """Yield the cases of some simulators."""
    for kind in kinds:
        for group in groups:
            for number, (wrong, missing) in enumerate(PLAN[group]):
                case_seed = [seed, *map(ord, kind + group), number]
                rng = np.random.default_rng(case_seed)
                effect = str(rng.choice(list(EFFECTS))) if missing else ""
                size = float(rng.uniform(*EFFECTS[effect][1:])) if effect else 0.0
                yield Case(kind, group, _draw_values(kind, wrong, rng), effect, size, int(rng.integers(1, 10**6)))


def _draw_values(kind: str, count: int, rng: np.random.Generator) -> dict[str, float]:
    """Return other values of some parameters, each visible by itself."""
    simulation, like = FunctionSimulation(kind, SIMULATORS[kind]), record(kind, {}, 1, 4.0)
    base, values = simulation.force(like), dict[str, float]()
    while len(values) < count:
        p = simulation.parameters[int(rng.integers(len(simulation.parameters)))]
        value = p.default * float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.47)))
        if p.name not in values and rms(simulation.with_values({p.name: value}).force(like) - base) > MIN_GAP_N:
            values[p.name] = value
    return values


def run(case: Case) -> Outcome:
    """Return the outcome of a diagnosis with two recordings, and a third held out."""
    missing = {EFFECTS[case.effect][0]: case.size} if case.effect else {}
    made = [record(case.kind, case.values, case.seed + k, SECONDS, **missing) for k in range(3)]
    simulation, begun = FunctionSimulation(case.kind, SIMULATORS[case.kind]), time.monotonic()
    d = diagnose(simulation, made[:2], held_out=made[2:], options=DiagnoseOptions(experiment=False))
    together = d.composition if d.verdict != NO_GAP else Explanation((), (), Composition(), (), 0.0, 0.0, (0.0, 0.0))
    parts = dict(zip(together.effects, together.estimates, strict=True))
    freed = {e.name: e.ci95 for e in parts.get(PARAMETERS, ())}
    named = frozenset((*freed, *(e for e in parts if e not in (PARAMETERS, TIMING))))
    holds = tuple(freed[n][0] <= v <= freed[n][1] for n, v in case.values.items() if n in freed)
    return Outcome(case, judge(d, case, named), named, holds, d.sentence, time.monotonic() - begun)


def judge(d: Diagnosis, case: Case, named: frozenset[str]) -> str:
    """Return how the diagnosis, which has `named` parameters and effects, compares with the truth."""
    replaced = [named - {old} | {new} for old in named for new in d.alternatives]
    if named == case.truth:
        return EXACT if d.verdict in (NAMED, NO_GAP) else TIE
    if case.truth in (*map(frozenset, d.explained_as_well), *replaced):
        return TIE
    wrong = named & {*EFFECTS_OF_LIBRARY} - {case.effect}
    return (FALSE if d.verdict == NAMED else UNSURE) if wrong else OTHER


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return a table with a row for each group of cases."""
    rows = [["cases", "number", EXACT, TIE, FALSE, "intervals that hold"]]
    for group in dict.fromkeys(o.case.group for o in outcomes):
        some = [o for o in outcomes if o.case.group == group]
        holds = [one for o in some for one in o.holds]
        counts = [sum(o.result == result for o in some) for result in (EXACT, TIE, FALSE)]
        rows.append([group, str(len(some)), *map(str, counts), f"{sum(holds)} of {len(holds)}"])
    return markdown(rows)


def main() -> None:
    """Run the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", nargs="+", default=list(SIMULATORS))
    parser.add_argument("--cases", nargs="+", default=list(PLAN))
    options, outcomes = parser.parse_args(), []
    for case in draw_cases(options.kinds, options.cases, options.seed):
        outcomes.append(run(case))
        print(outcomes[-1], flush=True)
    print(summarise(outcomes))


if __name__ == "__main__":
    main()
