"""What all search methods share: when to stop, the model that a start found, and a seeded start itself."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics import search_clock
from ces_identify.polynomial.problem import Problem
from ces_observer.structures.terms import MAX_TERMS

RANDOM, GAUSS_NEWTON, BOTH, THESIS = "random", "gauss-newton", "both", "thesis"
DEFAULT_TERMS = 25
METHODS = (BOTH, RANDOM, GAUSS_NEWTON, THESIS)


@dataclass(frozen=True)
class Limits:
    """When to stop: maximum number of `terms`, `time` [s], `target` cost [%], number of starts, first seed, threads.

    `method` chooses terms by random forward selection in `rounds`, by Gauss-Newton gain, or by both: every other start
    then continues with the latter from the result of the former. `thesis` is the thesis' own procedure
    (ces_identify.polynomial.selection). Without `exchanges`, a full model keeps its weak terms; without
    `terms`, `term_limit` says how many there may be.
    """

    terms: int | None = None
    time: float = 60.0
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
        return self.terms or (MAX_TERMS if self.method == THESIS else DEFAULT_TERMS)


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


class SearchStart(ABC):
    """A start from nothing or from the model `begin`; `listener` receives each better model."""

    def __init__(
        self,
        problem: Problem,
        limits: Limits,
        seed: int,
        deadline: float,
        stop: threading.Event,
        listener: Listener,
        begin: SearchResult | None = None,
    ) -> None:
        self.problem, self.limits, self.seed = problem, limits, seed
        self.deadline, self.stop, self.listener = deadline, stop, listener
        self.random = np.random.default_rng(seed)
        self.current = begin or self._first_model()
        self.trials = self.current.trials

    @abstractmethod
    def run(self) -> SearchResult:
        """Search until no candidate helps or a limit is reached or Ctrl-C; return the best model."""

    def _first_model(self) -> SearchResult:
        return SearchResult(np.empty(0, np.int64), np.empty(0), np.inf, self.seed, 0, "running")

    def _reason_to_end(self) -> str:
        if self.stop.is_set():
            return "interrupted"
        if self.current.cost <= self.limits.target:
            return "target cost reached"
        return "time is up" if search_clock.now() > self.deadline else ""
