"""The time constants of lags that rules leave open: what suits the data best, by short searches on the selection ticks.

A valve's force follows its current behind coil and pilot. How fast is seen best in a free run, so each time constant of
a grid is given a short search of its own, and the one of least selection cost is kept.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product

from ces_identify.gauss_newton import GaussNewtonStart
from ces_identify.limits import Limits
from ces_identify.problem import Problem, coarser, pose
from ces_identify.regressors import Rules
from ces_identify.series import Series
from ces_identify.weighting import EQUAL, Weighting

COARSE_S = (0.002, 0.005, 0.01, 0.02, 0.05)
FINER = (0.7, 1.4)  # times the best of these
TERMS = 12  # of the short searches
POLES = (0, 2)  # starts of Gauss-Newton selection, of which the better counts
COARSE_HZ = 250.0  # rate of these searches; the lag itself is made at the model's rate
SHARE = 0.3  # of the time for the search that all of them may take


def settled(
    rules: Rules, series: Sequence[Series], limits: Limits, stable: bool = True, weighting: Weighting = EQUAL
) -> Rules:
    """Return `rules` with every open time constant [s] set to the one of least selection cost [%] on `series`."""
    if not rules.open_lags:
        return rules
    step = max(1, round(series[0].rate_Hz / COARSE_HZ))
    searches = len(rules.open_lags) * len(POLES) * (len(COARSE_S) + len(FINER))
    each = SHARE * limits.seconds * limits.threads / searches
    short = replace(limits, seconds=each, target=0.0, most_terms=min(TERMS, limits.most_terms), exchanges=False)

    def costs(name: str, choices: Sequence[float]) -> dict[float, float]:
        tried = [rules.with_time_constant(name, seconds) for seconds in choices]
        with ThreadPoolExecutor(max(1, limits.threads)) as pool:
            problems = [coarser(pose(series, one.candidates(), stable, weighting), step) for one in tried]
            found = list(pool.map(_cost, *zip(*product(problems, [short], POLES), strict=True)))
        return {tau: min(found[i * len(POLES) : (i + 1) * len(POLES)]) for i, tau in enumerate(choices)}

    for name in rules.open_lags:
        known = costs(name, COARSE_S)
        best = min(known, key=known.__getitem__)
        known |= costs(name, [float(f"{factor * best:.3g}") for factor in FINER])
        rules = rules.with_time_constant(name, min(known, key=known.__getitem__))
    return rules


def _cost(problem: Problem, limits: Limits, pole: int) -> float:
    """Return the selection cost [%] a short search reaches."""
    deadline = time.monotonic() + limits.seconds
    start = GaussNewtonStart(problem, limits, limits.seed + pole, deadline, threading.Event(), lambda found: None)
    return start.run().cost
