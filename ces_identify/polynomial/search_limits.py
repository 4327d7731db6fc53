"""Settings and results that all search methods share: when to stop, and the model that a start found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ces_identify.numerics.arrays import F, I
from ces_observer.structures.terms_file import MAX_TERMS

RANDOM, GAUSS_NEWTON, BOTH, THESIS = "random", "gauss-newton", "both", "thesis"
DEFAULT_TERMS = 25
METHODS = (BOTH, RANDOM, GAUSS_NEWTON, THESIS)


@dataclass(frozen=True)
class Limits:
    """When to stop: maximum number of terms, seconds, target cost [%], number of starts, first seed, threads.

    `method` chooses terms by random forward selection in `rounds`, by Gauss-Newton gain, or by both: every other start
    then continues with the latter from the result of the former. `thesis` is the thesis' own procedure
    (ces_identify.polynomial.thesis_procedure). Without `exchanges`, a full model keeps its weak terms; without
    `max_terms`, `term_limit` says how many there may be.
    """

    max_terms: int | None = None
    seconds: float = 60.0
    target: float = 0.0
    starts: int = 8
    seed: int = 1
    threads: int = 4
    rounds: int = 2
    method: str = BOTH
    exchanges: bool = True

    @property
    def term_limit(self) -> int:
        """Maximum number of terms: by default DEFAULT_TERMS, for the thesis' procedure what a model file can hold."""
        return self.max_terms or (MAX_TERMS if self.method == THESIS else DEFAULT_TERMS)


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
