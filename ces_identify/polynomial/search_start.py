"""One seeded start of a search for terms: its problem, its limits and its current model."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod

import numpy as np

from ces_identify.numerics import search_clock
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.search_limits import Limits, Listener, SearchResult


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
