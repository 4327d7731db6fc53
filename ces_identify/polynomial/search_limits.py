"""Settings and results that all search methods share: when to stop, and the model that a start found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ces_identify.numerics.arrays import F, I

RANDOM, GAUSS_NEWTON, BOTH, THESIS = "random", "gauss-newton", "both", "thesis"
METHODS = (BOTH, RANDOM, GAUSS_NEWTON, THESIS)


@dataclass(frozen=True)
class Limits:
    """When to stop: maximum number of terms, seconds, target cost [%], number of starts, first seed, threads.

    `method` chooses terms by random forward selection in `rounds`, by Gauss-Newton gain, or by both: every other start
    then continues with the latter from the result of the former. `thesis` is the thesis' own procedure
    (ces_identify.polynomial.thesis_procedure). Without `exchanges`, a full model keeps its weak terms.
    """

    max_terms: int = 25
    seconds: float = 60.0
    target: float = 0.0
    starts: int = 8
    seed: int = 1
    threads: int = 4
    rounds: int = 2
    method: str = BOTH
    exchanges: bool = True


@dataclass(frozen=True)
class SearchResult:
    """A model: indices of its candidates, coefficients, selection cost [%], seed, and why the start stopped."""

    chosen: I
    coefficients: F
    cost: float
    seed: int
    trials: int
    ended: str


Listener = Callable[[SearchResult], None]
