"""One line that says what a script or notebook waits for: its step and the time since it began, each second anew."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from ces_observer.errors import CesError

Progress: TypeAlias = Callable[[str, float], None]  # the present step, and the share of the work that is done
ProgressInput: TypeAlias = Progress | bool | None
EVERY_S, WIDTH = 1.0, 110


@contextmanager
def show_progress(given: ProgressInput) -> Iterator[Progress]:
    """Give the function to call with each step: the user's own, or one that shows them while the context is open.

    None shows them where somebody looks: in a notebook and on a terminal.
    """
    if given is not None and not isinstance(given, bool) and not callable(given):
        raise CesError(f"progress: expected a function of (text, share), True, False or None; got {given!r}")
    if callable(given):
        yield given
    elif given is False or (given is None and not _is_watched()):
        yield lambda step, share: None
    else:
        newest, ended = [""], threading.Event()
        thread = threading.Thread(target=_rewrite, args=(newest, ended, _make_writer()), daemon=True)
        thread.start()
        try:
            yield lambda step, share: newest.__setitem__(0, step + (f", {share:.0%}" if share > 0.0 else ""))
        finally:
            ended.set()
            thread.join()


def _is_watched() -> bool:
    return "ipykernel" in sys.modules or sys.stderr.isatty()


def _make_writer() -> Callable[[str], None]:
    """Return what writes a line over the one before; a notebook stores the last one only."""
    if "ipykernel" in sys.modules:
        from IPython.display import display

        shown = display({"text/plain": ""}, raw=True, display_id=True)  # type: ignore[no-untyped-call]
        if shown is not None:
            return lambda line: shown.update({"text/plain": line}, raw=True)
    return lambda line: print(f"\r{line[:WIDTH]:{WIDTH}}" + "\r" * (not line), end="", file=sys.stderr, flush=True)


def _rewrite(newest: list[str], ended: threading.Event, write: Callable[[str], None]) -> None:
    """Write the newest step each second; leave an empty line."""
    began = time.monotonic()
    while not ended.wait(EVERY_S):
        write(f"{time.monotonic() - began:4.0f} s  {newest[0]}")
    write("")
