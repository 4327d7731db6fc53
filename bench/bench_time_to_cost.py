"""CPU seconds until a start of a search has a model whose J on an unseen recording is below a target.

Usage: python bench/bench_time_to_cost.py [--method both] [--terms 12 15 25] [--data 1,2,3 11,12,13 21,22,23]
[--starts 10]. For each limit on the terms and each data set of three seeds of damper_set (estimation, selection, test)
a search of so many starts, one after the other in one thread; each start is timed as if it were alone. Estimation and
selection are all that it sees: the test J of every improvement is noted along the way, and the time that takes is left
out. Posing the problem, with the valve's time constant found from the data, is counted for every start; compilation is
not.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import blas_one_thread  # noqa: F401 - before NumPy
from damper_set import RATE, series
from measurement import print_note, print_table

from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import BOTH, METHODS, Limits, SearchResult
from ces_identify.polynomial.selection import search
from ces_identify.preparation.cost import series_cost
from ces_identify.preparation.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.polynomial import build_problem
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term

SAMPLING = Sampling(RATE, 100.0, 0.01)  # the speed is an input: no differentiator is involved
TARGETS = {2.44: 3.0, 2.0: 10.0}  # J [%] and CPU s allowed to reach it
SECONDS = 30.0


@dataclass
class Watch:
    """Records starts one after the other: CPU time [s] of each improvement, without evaluation, and its test J.

    `improvements` holds (time [s], J [%]) by the seed of the start; building the problem took `spent` [s].
    """

    problem: Problem
    test: Series
    spent: float
    began: float = field(default_factory=time.process_time)
    left: float = field(default_factory=time.process_time)
    improvements: dict[int, list[tuple[float, float]]] = field(default_factory=dict)

    def __call__(self, result: SearchResult) -> None:
        now = time.process_time()
        if result.seed not in self.improvements:
            self.began = self.left  # the previous start ended with its last report
        model = model_of(self.problem, result)
        j = series_cost(self.test, simulate_series(model, self.test).force)
        self.improvements.setdefault(result.seed, []).append((self.spent + now - self.began, j))
        self.left = time.process_time()
        self.began += self.left - now

    def first(self, seed: int, target: float) -> float:
        """Return the CPU time [s] at which a start's J was first at most `target`, infinite if never."""
        return next((t for t, j in self.improvements[seed] if j <= target), math.inf)


def model_of(problem: Problem, result: SearchResult) -> Model:
    terms = [
        Term(float(c), problem.candidates[i].factors) for c, i in zip(result.coefficients, result.chosen, strict=True)
    ]
    return Model(SAMPLING, Polynomial(tuple(terms)), problem.envelope, problem.force_envelope)


def watch_starts(terms: int, seeds: Sequence[int], starts: int, method: str, seconds: float = SECONDS) -> Watch:
    """Return the record of `starts` starts on one data set."""
    estimation, selection, test = (series(seed) for seed in seeds)
    limits = Limits(terms, starts * seconds, starts=starts, threads=1, method=method)
    began = time.process_time()
    problem = build_problem([estimation, selection], IdentifyOptions(limits=limits))
    watch = Watch(problem, test, time.process_time() - began)
    search(problem, limits, watch)
    return watch


def row(terms: int, seeds: Sequence[int], starts: int, method: str) -> tuple[str, ...]:
    """Return a row of the table: the results of all starts on one data set."""
    watch = watch_starts(terms, seeds, starts, method)
    last = [records[-1] for records in watch.improvements.values()]
    cells = [f"{watch.spent:.2f}"]
    for target, limit in TARGETS.items():
        times = [watch.first(seed, target) for seed in watch.improvements]
        within = sum(t <= limit for t in times)
        mark = "met" if within == starts else f"**missed by {starts - within}**"
        cells += [*map(_seconds, (statistics.median(times), max(times))), f"{within} of {starts}", mark]
    costs = [j for _, j in last]
    final = (f"{min(costs):.2f} to {max(costs):.2f}", f"{statistics.median(t for t, _ in last):.1f}")
    print_note(f"{terms} terms, {seeds}: {cells}, J at the end {final[0]}")
    return (str(terms), ", ".join(map(str, seeds)), *cells, *final)


def _seconds(time_s: float) -> str:
    return f"{time_s:.2f}" if math.isfinite(time_s) else "never"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", choices=METHODS, default=BOTH)
    parser.add_argument("--terms", type=int, nargs="+", default=[12, 15, 25], help="maximum number of terms of a model")
    parser.add_argument("--data", nargs="+", default=["1,2,3", "11,12,13", "21,22,23"], metavar="E,S,T")
    parser.add_argument("--starts", type=int, default=10, help="seeds 1 to this, default 10")
    options = parser.parse_args()
    watch_starts(12, (1, 2, 3), 2, options.method, 3.0)  # compiles
    header = ["most terms", "seeds of data", "posing CPU s"]
    for target, limit in TARGETS.items():
        to = f"to J {target:g}: "
        header += [to + "median CPU s", "worst", f"starts within {limit:g} s", "target"]
    header += ["test J at the end", "median CPU s of a start"]
    data = [tuple(map(int, seeds.split(","))) for seeds in options.data]
    rows = [row(terms, seeds, options.starts, options.method) for terms in options.terms for seeds in data]
    print_table(header, rows)


if __name__ == "__main__":
    main()
