"""Work that takes seconds, each in a process of its own: pages ask for it again until its result is there.

`Works` is the server's side; run as a program, this module is the process: a task as JSON in, a file with the result
out. Memory, files and time of the process are limited: a small recording may unpack to any size.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError

MAX_RUNNING, MAX_KEPT = 2, 32
LIMIT_S = 180
LIMITS = ((resource.RLIMIT_AS, 8 << 30), (resource.RLIMIT_FSIZE, 8 << 30), (resource.RLIMIT_CORE, 0))
NEED = ("position", "current", "force")


@dataclass(frozen=True)
class WorkState:
    """How far some work is: its result, or why it failed, or neither while it runs or waits."""

    result: str | None = None
    problem: str = ""


class Works:
    """Runs work by key and keeps the latest results; may be used by many threads. `close` ends what runs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._scratch = Path(tempfile.mkdtemp(prefix="ces-serve-"))
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._ended: OrderedDict[str, WorkState] = OrderedDict()

    def ask(self, key: str, task: Mapping[str, Any]) -> WorkState:
        """Return the state of the work `key`; it is begun when it is asked for first and a process is free."""
        with self._lock:
            for other, process in list(self._running.items()):
                if process.poll() is not None:
                    self._ended[other] = self._collect(other, self._running.pop(other).returncode)
            while len(self._ended) > MAX_KEPT:
                self._ended.popitem(last=False)
            if key not in self._ended and key not in self._running and len(self._running) < MAX_RUNNING:
                self._running[key] = self._start(key, task)
            return self._ended.get(key, WorkState())

    def find(self, key: str) -> str | None:
        """Return a result that is kept."""
        with self._lock:
            return self._ended.get(key, WorkState()).result

    def close(self) -> None:
        """End all processes and remove their files."""
        with self._lock:
            for process in self._running.values():
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            shutil.rmtree(self._scratch, ignore_errors=True)

    def _start(self, key: str, task: Mapping[str, Any]) -> subprocess.Popen[bytes]:
        """Start a process in a group of its own, so that Ctrl-C at the terminal reaches the server alone."""
        folder = self._scratch / key
        folder.mkdir(parents=True, exist_ok=True)
        words = [sys.executable, "-m", "ces_serve.work", json.dumps(task), str(folder / "result")]
        with (folder / "errors").open("wb") as errors:
            environment = {**os.environ, "TMPDIR": str(folder)}
            return subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, start_new_session=True, env=environment
            )

    def _collect(self, key: str, status: int) -> WorkState:
        """Return what a process has left, and remove its files."""
        folder = self._scratch / key
        try:
            if status == 0:
                return WorkState((folder / "result").read_text(encoding="utf-8"))
            if status == -signal.SIGALRM:
                return WorkState(problem=f"stopped: it took longer than {LIMIT_S} s")
            lines = (folder / "errors").read_text(encoding="utf-8", errors="replace").splitlines()
            return WorkState(problem=lines[-1] if lines else f"the process ended without a result (status {status})")
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def main(task: str, out: str) -> int:
    """Do a task and write its result to the file `out`; returns 0, or 1 with the reason on standard error."""
    from ces_serve.contents import to_json
    from ces_serve.inspection import inspect_recording

    for kind, limit in LIMITS:
        hard = resource.getrlimit(kind)[1]
        value = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (value, value))
    signal.alarm(LIMIT_S)
    given = json.loads(task)
    try:
        if "models" in given:
            text = compare_files(given["models"], given["bags"], given["signals"])
        else:
            text = to_json(inspect_recording(given["path"], given["signals"]))
        Path(out).write_text(text, encoding="utf-8")
    except (CesError, OSError, MemoryError) as error:
        print(str(error) or "not enough memory", file=sys.stderr)
        return 1
    return 0


def compare_files(models: list[str], bags: list[str], signals: str | None) -> str:
    """Return the page that compares model files on bags; raises CesError."""
    from ces_data.bags.reader import read_recording
    from ces_data.findings import require_usable
    from ces_data.signals_file import load_signals
    from ces_identify.comparison.compared_models import make_compared_model, name_sources
    from ces_identify.comparison.comparison import compare
    from ces_identify.comparison.comparison_report import comparison_page
    from ces_identify.simulations.simulation import ModelSimulation
    from ces_observer.model import load_model

    described = load_signals(Path(signals) if signals else None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of stamps; the pages of the recordings show them
        recordings = [read_recording(Path(bag), described, NEED) for bag in bags]
    for recording in recordings:
        require_usable(recording)
    compared = [
        make_compared_model(name, ModelSimulation(load_model(path)), path)
        for name, path in zip(name_sources(models), models, strict=True)
    ]
    return comparison_page(compare(compared, recordings, (0.0, 1.0), timing=False))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
