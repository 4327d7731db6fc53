"""The progress file of a program that runs for long: a hidden file beside its output, gone when the program ends.

Other programs, such as `ces serve`, read it to show the work. Its first line says who writes what; one line of JSON
follows for each result so far. A program that was killed leaves its file behind; the process that is named there shows
that it has ended, and the next run with the same output replaces it.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from ces_identify.polynomial.search_limits import SearchResult

SCHEMA = "ces-progress/1"
SUFFIX = ".progress"
MAX_BYTES = 8_000_000
FOREIGN_SILENCE_S = 60.0  # without a new line for so long, a run on another computer is taken for ended
RUNNING = "running"
ENDED = ("Z", "X")  # states of a process in /proc


def progress_path(output: Path) -> Path:
    """Return the progress file of the file or folder `output`."""
    return output / SUFFIX if output.is_dir() else output.with_name(f".{output.name}{SUFFIX}")


class ProgressFile:
    """Writes the progress file of `output` while its context is open; `write` may be called from any thread.

    `facts` describe the work. A file that cannot be written, such as on a full disk, never stops the work.
    """

    def __init__(self, program: str, output: Path, facts: Mapping[str, Any]) -> None:
        self._path = progress_path(output)
        pid = os.getpid()
        process = {"host": socket.gethostname(), "pid": pid, "process_start": _process_start(pid)}
        began = {"began_s": round(time.time(), 3)}
        self._head = {"schema": SCHEMA, "program": program, "output": output.name, **process, **began, **facts}
        self._lock = threading.Lock()
        self._began_s = time.monotonic()
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        with suppress(OSError):
            self._path.unlink(missing_ok=True)  # of a killed run, or a link, which may lead to any file
            self._file = self._path.open("x", encoding="utf-8", errors="replace")  # a name may be no text
            self._write_line(self._head)
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        with self._lock, suppress(OSError):
            file, self._file = self._file, None
            if file is not None:
                identity = os.fstat(file.fileno())
                file.close()
                if os.path.samestat(identity, self._path.stat()):  # else a program with the same output has replaced it
                    self._path.unlink()

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row, with the seconds since the start as `elapsed_s`."""
        with self._lock, suppress(OSError):
            self._write_line({"elapsed_s": round(time.monotonic() - self._began_s, 3), **row})

    def _write_line(self, row: Mapping[str, Any]) -> None:
        if self._file is not None:
            self._file.write(json.dumps(row, ensure_ascii=False) + "\n")
            self._file.flush()


class SearchProgressFile(ProgressFile):
    """A row for each better model and for each start that ends; call `begin_step` before each search."""

    _best = float("inf")

    def begin_step(self, step: str) -> None:
        """Write what begins; the next search starts without a best cost."""
        self._best = float("inf")
        self.write({"step": step})

    def listen(self, result: SearchResult) -> None:
        """Write a result if it says something new."""
        with self._lock:
            better = result.cost < self._best
            self._best = min(self._best, result.cost)
        if better or result.ended != RUNNING:
            cost = round(result.cost, 6) if result.cost < float("inf") else None
            self.write({"seed": result.seed, "cost": cost, "size": len(result.chosen), "ended": result.ended})


@dataclass(frozen=True)
class RunProgress:
    """What a progress file says: `head` about the work, `rows` in their order; whether its program is still running."""

    head: Mapping[str, Any]
    rows: tuple[Mapping[str, Any], ...]
    alive: bool


def read_progress(path: Path) -> RunProgress | None:
    """Return the content of a progress file; None if there is none, or not one that can be read."""
    try:
        if not path.is_file():  # opening a pipe would wait
            return None
        with path.open("rb") as file:
            lines = file.read(MAX_BYTES).rpartition(b"\n")[0].splitlines()
            written_s = os.fstat(file.fileno()).st_mtime
        rows = [json.loads(line) for line in lines]
    except (OSError, ValueError, RecursionError):
        return None
    if not rows or not all(isinstance(row, dict) for row in rows) or rows[0].get("schema") != SCHEMA:
        return None
    return RunProgress(rows[0], tuple(rows[1:]), _is_alive(rows[0], written_s))


def _is_alive(head: Mapping[str, Any], written_s: float) -> bool:
    """Return whether the process that wrote `head` is running; a number that was used again has another start."""
    pid = head.get("pid")
    if head.get("host") != socket.gethostname() or not isinstance(pid, int):
        return time.time() - written_s < FOREIGN_SILENCE_S
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return _process_start(pid) == head.get("process_start")


def _process_start(pid: int) -> str:
    """Return when a process started, in kernel ticks; empty without /proc, and for one that has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return "" if fields[0] in ENDED else fields[19]  # one that ended is there until its parent asks, perhaps never
    except (OSError, IndexError):
        return ""
