"""Other load of the computer: one process on each core that never waits, at ordinary priority."""

from __future__ import annotations

import os
import subprocess
import sys
from types import TracebackType

PROGRAM = "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True:\n    pass"


class Hogs:
    """A busy process on each core while the context lasts; none if `busy` is False."""

    def __init__(self, busy: bool) -> None:
        self._cores = sorted(os.sched_getaffinity(0)) if busy else []
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Hogs:
        self._processes = [subprocess.Popen([sys.executable, "-c", PROGRAM, str(core)]) for core in self._cores]
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
