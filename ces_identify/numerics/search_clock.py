"""The clock of a search, which stops while a kernel is compiled.

The first run on a computer then gives the same result as later ones.
"""

from __future__ import annotations

import time

from numba.core import event


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


def now() -> float:
    """Return the seconds of a clock that stops during compilation in this process."""
    return _COMPILING.subtract_compilation(time.monotonic())
