"""A clock in place of the module `time`, for what must not depend on how busy the computer is."""

from __future__ import annotations

import threading
import time


class BusyClock:
    """Runs as the clock does, but never faster than the processor time of this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._now = time.monotonic()
        self._before = self._now, time.process_time()

    def monotonic(self) -> float:
        """Return the seconds since some moment."""
        with self._lock:
            now = time.monotonic(), time.process_time()
            self._now += min(after - before for after, before in zip(now, self._before, strict=True))
            self._before = now
            return self._now
