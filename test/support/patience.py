"""Waiting for a condition, and the processes of this computer, in tests that no busy computer may break."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
PATIENCE_S = 120.0  # only what hangs takes longer, however busy the computer is
POLL_S = 0.01


def wait_until(condition: Callable[[], T], what: object = "") -> T:
    """Return the first true value of `condition`; fails, with `what`, if there is none within PATIENCE_S."""
    end = time.monotonic() + PATIENCE_S
    while True:
        late = time.monotonic() > end
        if found := condition():
            return found
        assert not late, what
        time.sleep(POLL_S)


def command_of(pid: int | str) -> bytes:
    """Return the command line of a process; empty when it has ended, also while its parent has not waited for it."""
    return _read(Path("/proc", str(pid), "cmdline"))


def children_running(module: str) -> set[str]:
    """Return the numbers of this process' children that run a Python module."""
    pids = {pid for path in Path("/proc/self/task").glob("*/children") for pid in _read(path).decode().split()}
    return {pid for pid in pids if module.encode() in command_of(pid)}


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""
