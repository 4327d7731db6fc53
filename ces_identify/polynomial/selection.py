"""The search for terms: seeded starts in parallel threads, by random selection, Gauss-Newton gain, both, or as in the
thesis.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager

from ces_identify.numerics import search_clock
from ces_identify.polynomial.gauss_newton import GaussNewtonStart
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.random_forward import RandomForwardStart
from ces_identify.polynomial.search_limits import BOTH, GAUSS_NEWTON, RANDOM, THESIS, Limits, Listener, SearchResult
from ces_identify.polynomial.thesis_procedure import ThesisStart

POLL_S = 0.1  # between two checks for Ctrl-C


def search(problem: Problem, limits: Limits, listener: Listener = lambda result: None) -> list[SearchResult]:
    """Run the starts in parallel threads; return their results, best first.

    Ctrl-C stops every start and returns the best so far, or raises KeyboardInterrupt if there is none. `listener`
    receives each improvement and each start's result, from the threads.
    """
    stop = threading.Event()
    deadline = search_clock.now() + limits.seconds
    with _stop_on_interrupt(stop), ThreadPoolExecutor(max(1, limits.threads)) as pool:
        seeds = range(limits.seed, limits.seed + limits.starts)
        starts = [pool.submit(_start, problem, limits, seed, deadline, stop, listener) for seed in seeds]
        results = _gather(starts, stop)
    if not results:
        raise KeyboardInterrupt
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


def _start(
    problem: Problem, limits: Limits, seed: int, deadline: float, stop: threading.Event, listener: Listener
) -> SearchResult:
    """Run one start by `limits.method`; with both, every other start continues from a random selection."""
    arguments = problem, limits, seed, deadline, stop, listener
    if limits.method == THESIS:
        return ThesisStart(*arguments).run()
    if limits.method == GAUSS_NEWTON or (limits.method == BOTH and (seed - limits.seed) % 2 == 0):
        return GaussNewtonStart(*arguments).run()
    result = RandomForwardStart(*arguments).run()
    return result if limits.method == RANDOM else GaussNewtonStart(*arguments, result).run()


def _gather(starts: list[Future[SearchResult]], stop: threading.Event) -> list[SearchResult]:
    """Wait for the starts; after Ctrl-C only for those that are running, as thousands may be queued."""
    for start in starts:
        while not start.done():
            if stop.is_set():
                start.cancel()
            wait([start], timeout=POLL_S)
    return [start.result() for start in starts if not start.cancelled()]
