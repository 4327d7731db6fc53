"""What every way of selection shares: when to stop, and what a start has found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

I = NDArray[np.int64]  # noqa: E741

RANDOM, GAUSS_NEWTON, BOTH = "random", "gauss-newton", "both"
METHODS = (BOTH, RANDOM, GAUSS_NEWTON)


@dataclass(frozen=True)
class Limits:
    """When to stop: most terms, seconds, target cost [%], number of starts, first seed, threads.

    `method` is how terms are chosen: by random forward selection (thesis fig. 3.2), each start of which goes on for
    `rounds`, by Gauss-Newton gain, or by both: every other start goes on by the latter from what the former found.
    Without `exchanges`, weak terms stay once the model is full.
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
    """A model found: indices of its candidates, coefficients, selection cost [%], seed and why the start ended."""

    chosen: I
    coefficients: NDArray[np.float64]
    cost: float
    seed: int
    trials: int
    ended: str


Listener = Callable[[SearchResult], None]
