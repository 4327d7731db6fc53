"""Says when numerical kernels are compiled: once on a computer, in silence for a minute or more."""

from __future__ import annotations

from collections.abc import Callable

from numba.core import event

NOTICE = "compiling numerical kernels, once on this computer: about a minute, longer if it is busy"


class CompilationNotice(event.Listener):  # type: ignore[misc]  # numba has no types
    """Calls `tell` with NOTICE when the first kernel is compiled, not when it comes from the cache."""

    def __init__(self, tell: Callable[[str], object]) -> None:
        self._tell: Callable[[str], object] | None = tell
        event.register("numba:compile", self)

    def on_start(self, started: event.Event) -> None:
        """Tell it, once, unless the kernel is a user's own."""
        function = getattr((started.data or {}).get("dispatcher"), "py_func", None)
        if self._tell is not None and str(getattr(function, "__module__", "")).startswith("ces_"):
            tell, self._tell = self._tell, None
            tell(NOTICE)

    def close(self) -> None:
        """Listen no more."""
        event.unregister("numba:compile", self)

    def on_end(self, _: event.Event) -> None:
        """Do nothing."""
