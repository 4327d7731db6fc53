"""Processor load since the last measurement, as shares of one core: of the process and of the calling thread."""

from __future__ import annotations

from time import monotonic, process_time, thread_time

from ces_observer.health.status_values import Load


class LoadMeter:
    """Measures the processor time between two calls."""

    def __init__(self) -> None:
        self._before = monotonic(), process_time(), thread_time()

    def measure(self) -> Load:
        """Return the shares since the last call; to be called by the thread that runs the executor."""
        now = monotonic(), process_time(), thread_time()
        elapsed, process, thread = (b - a for a, b in zip(self._before, now, strict=True))
        self._before = now
        return Load(process / elapsed, thread / elapsed) if elapsed > 0.0 else Load()
