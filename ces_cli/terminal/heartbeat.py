"""Says what a program does while it prints nothing: a line every few seconds, unless a live bar shows it."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

QUIET_S = 4.0  # after the last line; nobody waits longer than 5 s for a sign of life


class Heartbeat:
    """The steps of the running program, the innermost last, and the thread that prints that one."""

    def __init__(self) -> None:
        self._steps: list[str] = []
        self._live = 0  # bars on a terminal
        self._ended = threading.Event()
        self._began = self._printed = time.monotonic()

    @property
    def elapsed_s(self) -> float:
        """Seconds since the program began."""
        return time.monotonic() - self._began

    @contextmanager
    def beat(self, step: str) -> Iterator[None]:
        """Print the innermost step whenever nothing was printed for a while, until the context closes."""
        self._began = self._printed = time.monotonic()
        self._ended = ended = threading.Event()
        thread = threading.Thread(target=self._run, args=(ended,), daemon=True)
        thread.start()
        try:
            with self.step(step):
                yield
        finally:
            ended.set()
            thread.join()

    def stop(self) -> None:
        """Print no more, as in a program that waits for its user."""
        self._ended.set()

    @contextmanager
    def step(self, text: str, live: bool = False) -> Iterator[None]:
        """Do a step; one that is `live` on a terminal needs no lines."""
        depth = len(self._steps)
        self._steps.append(text)
        self._live += live
        try:
            yield
        finally:
            del self._steps[depth:]
            self._live -= live

    def change(self, text: str) -> None:
        """Say more of the innermost step."""
        self._steps[-1:] = [text]

    def touch(self) -> None:
        """Count the silence from now on: something was printed."""
        self._printed = time.monotonic()

    def _run(self, ended: threading.Event) -> None:
        while not ended.wait(max(0.1, self._printed + QUIET_S - time.monotonic())):
            if time.monotonic() - self._printed < QUIET_S or self._live:
                continue
            self.touch()
            with suppress(OSError, ValueError, IndexError):  # the stream may be closed, and a step just ended
                print(f"{self.elapsed_s:5.0f} s  {self._steps[-1]}", file=sys.stderr, flush=True)


heartbeat = Heartbeat()
