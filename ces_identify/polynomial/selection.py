"""The search for terms: seeded starts in parallel threads, by random selection, Gauss-Newton gain, or both."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager

from ces_identify.numerics import search_clock
from ces_identify.polynomial.gauss_newton import GaussNewtonStart
from ces_identify.polynomial.limits import BOTH, GAUSS_NEWTON, RANDOM, Limits, Listener, SearchResult
from ces_identify.polynomial.problem import Problem
from ces_identify.polynomial.random_forward import RandomForwardStart

POLL_S = 0.1  # between two looks for Ctrl-C


def search(problem: Problem, limits: Limits, listener: Listener = lambda found: None) -> list[SearchResult]:
    """Run the starts in parallel threads; return what each found, best first.

    Ctrl-C ends every start and returns the best so far; it raises KeyboardInterrupt if there is nothing yet. `listener`
    hears each improvement and each end of a start, from the threads.
    """
    stop = threading.Event()
    deadline = search_clock.now() + limits.seconds
    with _stop_on_interrupt(stop), ThreadPoolExecutor(max(1, limits.threads)) as pool:
        seeds = range(limits.seed, limits.seed + limits.starts)
        starts = [pool.submit(_start, problem, limits, seed, deadline, stop, listener) for seed in seeds]
        found = _gather(starts, stop)
    if not found:
        raise KeyboardInterrupt
    return sorted(found, key=lambda f: (f.cost, f.seed))


@contextmanager
def _stop_on_interrupt(stop: threading.Event) -> Iterator[None]:
    """Let Ctrl-C set `stop`. As an exception it would strike anywhere, such as between taking a lock and minding it."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    before = signal.signal(signal.SIGINT, lambda number, frame: stop.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


def _start(
    problem: Problem, limits: Limits, seed: int, deadline: float, stop: threading.Event, listener: Listener
) -> SearchResult:
    """Run one start by the method asked for; with both, every other one goes on from what random selection found."""
    if limits.method == GAUSS_NEWTON or (limits.method == BOTH and (seed - limits.seed) % 2 == 0):
        return GaussNewtonStart(problem, limits, seed, deadline, stop, listener).run()
    found = RandomForwardStart(problem, limits, seed, deadline, stop, listener).run()
    if limits.method == RANDOM:
        return found
    return GaussNewtonStart(problem, limits, seed, deadline, stop, listener, found).run()


def _gather(starts: list[Future[SearchResult]], stop: threading.Event) -> list[SearchResult]:
    """Wait for the starts; after Ctrl-C only for those that run, as thousands may wait for a thread."""
    for start in starts:
        while not start.done():
            if stop.is_set():
                start.cancel()
            wait([start], timeout=POLL_S)
    return [start.result() for start in starts if not start.cancelled()]
