"""The search for terms: seeded starts in parallel threads, by random selection, Gauss-Newton gain, or both."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor

from ces_identify.gauss_newton import GaussNewtonStart
from ces_identify.limits import BOTH, GAUSS_NEWTON, RANDOM, Found, Limits, Listener
from ces_identify.problem import Problem
from ces_identify.random_forward import RandomForwardStart


def search(problem: Problem, limits: Limits, listener: Listener = lambda found: None) -> list[Found]:
    """Run the starts in parallel threads; return what each found, best first.

    Ctrl-C ends every start and returns the best so far. `listener` hears each improvement and each end of a start,
    from the threads.
    """
    stop = threading.Event()
    deadline = time.monotonic() + limits.seconds
    with ThreadPoolExecutor(max(1, limits.threads)) as pool:
        starts: list[Future[Found]] = []
        try:
            seeds = range(limits.seed, limits.seed + limits.starts)
            starts.extend(pool.submit(_start, problem, limits, seed, deadline, stop, listener) for seed in seeds)
        except KeyboardInterrupt:
            stop.set()
            if not starts:
                raise
        found = _gather(starts, stop)
    return sorted(found, key=lambda f: (f.cost, f.seed))


def _start(
    problem: Problem, limits: Limits, seed: int, deadline: float, stop: threading.Event, listener: Listener
) -> Found:
    """Run one start by the method asked for; with both, every other one goes on from what random selection found."""
    if limits.method == GAUSS_NEWTON or (limits.method == BOTH and (seed - limits.seed) % 2 == 0):
        return GaussNewtonStart(problem, limits, seed, deadline, stop, listener).run()
    found = RandomForwardStart(problem, limits, seed, deadline, stop, listener).run()
    if limits.method == RANDOM:
        return found
    return GaussNewtonStart(problem, limits, seed, deadline, stop, listener, found).run()


def _gather(starts: list[Future[Found]], stop: threading.Event) -> list[Found]:
    """Wait for the starts; after Ctrl-C only for those that run, as thousands may wait for a thread.

    One is waited for at a time: concurrent.futures.wait holds the locks of all, and keeps them if Ctrl-C strikes there.
    """
    while True:
        try:
            for start in starts if stop.is_set() else ():
                start.cancel()
            for start in starts:
                if not start.cancelled():
                    start.exception()
            return [start.result() for start in starts if not start.cancelled()]
        except KeyboardInterrupt:
            stop.set()
