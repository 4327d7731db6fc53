"""What searches share: when to stop, starts and the best model of each, many of them in threads, and their clock.

The clock stops while a kernel is compiled, so that the first run on a computer gives the same result as later ones.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np
from numba.core import event

from ces_data.arrays import F, I
from ces_observer.limits import FileLimits

GAUSS_NEWTON, THESIS = "gauss-newton", "thesis"
DEFAULT_TERMS = 25
RUNNING = "running"  # a start that has not ended
INTERRUPTED = "interrupted"  # by Ctrl-C: why a start ended
TIME_IS_UP = "ended by --time: another machine may answer differently"
WORK_IS_DONE, STEPS_DONE = "its share of the work is done", "steps exhausted"
NO_MORE_GAIN = "no more gain on the selection ticks"
POLL_S = 0.1  # between two checks for Ctrl-C
LONG_TICKS, MIN_STARTS = 100_000, 2
METHODS = (GAUSS_NEWTON, THESIS)


@dataclass(frozen=True)
class Limits:
    """When to stop: maximum number of `terms`, `time` [s], `target` cost [%], number of starts, first seed, threads.

    The size of a search is counted in `work`, relative to the default, so that the same seed gives the same model on
    any machine and with any number of threads; `time` is a hard end, by default none.

    `method` chooses terms by Gauss-Newton gain, or as the thesis does (ces_identify.polynomial.selection). Without
    `exchanges`, a full model keeps its weak terms; without `terms`, `term_limit` says how many there may be. A search
    that half-way costs more than `hopeless` [%] may end there. Searches side by side share an event to `stop`.
    """

    terms: int | None = None
    time: float = inf
    target: float = 0.0
    starts: int = 8
    seed: int = 1
    threads: int = 4
    method: str = GAUSS_NEWTON
    exchanges: bool = True
    work: float = 1.0
    hopeless: float = inf
    stop: threading.Event | None = None

    def within(self, end_s: float, share: float = 1.0) -> Limits:
        """Return the limits with a share of the time until `end_s` of `clock_s`."""
        return replace(self, time=max(0.0, share * (end_s - clock_s())))

    @property
    def term_limit(self) -> int:
        """Maximum number of terms: by default DEFAULT_TERMS, for the thesis' procedure what a model file can hold."""
        return self.terms or (FileLimits.MAX_TERMS if self.method == THESIS else DEFAULT_TERMS)


@dataclass(frozen=True)
class SearchResult:
    """A model: indices of its candidates, coefficients, selection cost [%], seed, and why the start stopped.

    `share` is that of the start's work so far (0 to 1); `met` are the best models of other sizes on its way. Of several
    structures, `structure` is the name.
    """

    chosen: I
    coefficients: F
    cost: float
    seed: int
    trials: int
    ended: str
    share: float = 0.0
    met: tuple[SearchResult, ...] = ()
    structure: str = ""


Listener = Callable[[SearchResult | str], None]  # of an improvement, the end of a start, or the step that begins


def spread_work(limits: Limits, ticks: int) -> Limits:
    """Return the limits for recordings of so many ticks: beyond LONG_TICKS fewer starts of more work each."""
    scale = max(1.0, ticks / LONG_TICKS)
    starts = min(limits.starts, max(MIN_STARTS, round(limits.starts / scale)))
    return replace(limits, starts=starts, work=scale * limits.work)


class SearchStart:
    """One seeded start until its limits or the `stop` end it, and the `best` model that it has met."""

    def __init__(self, limits: Limits, listener: Listener = lambda result: None, number: int = 0) -> None:
        self.limits, self.listener, self.seed = limits, listener, limits.seed + number
        self.deadline, self.stop = clock_s() + limits.time, limits.stop or threading.Event()
        self.random = np.random.default_rng(self.seed)
        self.best = SearchResult(np.empty(0, np.int64), np.empty(0), inf, self.seed, 0, RUNNING)

    def keep(self, **changes: Any) -> None:
        """Change the best model, and tell the listener."""
        self.best = replace(self.best, **changes)
        self.listener(self.best)

    def reason_to_end(self) -> str:
        """Return why the start ends; empty if it goes on."""
        if self.stop.is_set():
            return INTERRUPTED
        if self.best.cost <= self.limits.target:
            return "target cost reached"
        return TIME_IS_UP if clock_s() > self.deadline else ""


def run_starts(limits: Limits, listener: Listener, run: Callable[[SearchStart], SearchResult]) -> list[SearchResult]:
    """Call `run` for every start in parallel threads; return the results, best first.

    Ctrl-C stops all; the best so far are returned, or KeyboardInterrupt is raised if there is none. If the time ended
    one, all of them say so: more time might have made it the best.
    """
    stop = limits.stop or threading.Event()
    own = [SearchStart(replace(limits, stop=stop), listener, number) for number in range(limits.starts)]
    with _stop_on_interrupt(stop), ThreadPoolExecutor(max(1, limits.threads)) as pool:
        starts = [pool.submit(run, start) for start in own]
        for start in starts:
            while not start.done():  # after Ctrl-C wait only for those that are running: thousands may be queued
                if stop.is_set():
                    start.cancel()
                wait([start], timeout=POLL_S)
        results = [start.result() for start in starts if not start.cancelled()]
    if not results:
        raise KeyboardInterrupt
    if any(result.ended == TIME_IS_UP for result in results):
        results = [replace(result, ended=TIME_IS_UP) for result in results]
    return sorted(results, key=lambda result: (result.cost, result.seed))


@contextmanager
def _stop_on_interrupt(stop: threading.Event) -> Iterator[None]:
    """Let Ctrl-C set `stop`; as an exception it could strike anywhere, even right after a lock is taken."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread can handle signals
        return
    before = signal.signal(signal.SIGINT, lambda number, frame: stop.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


class _Compiling(event.Listener):  # type: ignore[misc]  # numba has no types
    """Adds up the seconds of compilation; one thread compiles at a time, under a lock of numba."""

    def __init__(self) -> None:
        self._depth, self._began, self._ended = 0, 0.0, 0.0

    def on_start(self, _: event.Event) -> None:
        if self._depth == 0:
            self._began = time.monotonic()
        self._depth += 1

    def on_end(self, _: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._ended += time.monotonic() - self._began

    def subtract_compilation(self, now: float) -> float:
        """Return `now`, from time.monotonic(), less all compilation before it."""
        return (self._began if self._depth else now) - self._ended


_COMPILING = _Compiling()
event.register("numba:compile", _COMPILING)


def clock_s() -> float:
    """Return the seconds of a clock that stops during compilation in this process."""
    return _COMPILING.subtract_compilation(time.monotonic())
