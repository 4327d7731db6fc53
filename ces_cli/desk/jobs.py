"""Jobs: a program run as a process of its own, in a folder with its results that keeps its command, lines and status.

No child of the server, it outlives it. All that is known of it is there: its processes hold a lock on the log.
"""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import signal
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, Popen

from werkzeug.datastructures import MultiDict

from ces_cli.desk.folder import MODEL, RECORDING
from ces_identify.options import STRUCTURE, list_options
from ces_observer.errors import CesError

NAME = re.compile(r"([0-9]{2,6})_[a-z]+")
COMMAND, LOG, STATUS = "command", "log", "status"
RUNNING, CANCELLED = "running", "cancelled"
STATES = {"ended 0": "done", CANCELLED: CANCELLED}  # others have failed, or were interrupted, as by a power cut
TAIL_BYTES, GRACE_S = 1 << 16, 3.0  # of the lines that are shown, and for a program to remove what is half written [s]
HEARTBEAT = re.compile(r" *[0-9]+ s  ")
START = ("-P", "-m", "ces_cli.main")
SCRIPT = '(echo "process $$" > "$0"; PYTHONSAFEPATH=1 PYTHONUNBUFFERED=1 COLUMNS=110 "$@"; echo "ended $?" > "$0") &'
STRUCTURES: Sequence[str] = next(option.choices for option in list_options() if option.name == STRUCTURE)
PLAIN = re.compile(r"(?!-)[\w .,+()=/-]+")  # a path that no program reads as an option, a pattern or a name in a file
PROGRAMS = {  # the least and the most models, and the words; those in capitals stand for what is chosen
    "info": (0, 99, "RECORDINGS"),
    "characterise": (0, 99, "RECORDINGS BESIDE PART --out FOLDER/result"),
    "identify": (0, 99, "RECORDINGS PART SEARCH --out FOLDER/model_NUMBER.json --report FOLDER/report.html"),
    "validate": (1, 1, "MODELS RECORDINGS PART --report FOLDER/report.html"),
    "compare": (2, 8, "MODELS RECORDINGS PART --report FOLDER/report.html"),
    "diagnose": (1, 1, "--sim MODELS --real RECORDINGS PART --out FOLDER/result"),
}


def make_words(chosen: MultiDict[str, str], program: str, folder: str, signals: str) -> list[str]:
    """Return the words of `ces PROGRAM` that writes into a folder; raises CesError if they cannot be made yet."""
    low, high, template = PROGRAMS[program]
    recordings, models = chosen.getlist(RECORDING), chosen.getlist(MODEL)
    if odd := [path for path in (*recordings, *models) if not PLAIN.fullmatch(path)]:
        raise CesError(f"rename {odd[0]}: programs read a leading - and the letters *?[]#: in another way")
    if not recordings:
        raise CesError("choose a recording")
    if not low <= len(models) <= high:
        raise CesError(f"choose {'one model' if high == 1 else 'two or more models'}; chosen: {len(models)}")
    begin, end, structure, limit = (chosen.get(key, "") for key in ("from", "to", "structure", "time"))
    words = {"RECORDINGS": recordings, "MODELS": models}
    words["BESIDE"] = [word for model in models for word in ("--model", model)]
    words["PART"] = ["--part", _as_seconds(begin or "0"), _as_seconds(end)] if begin or end else []
    words["SEARCH"] = ["--structure", structure] if structure in STRUCTURES else []
    words["SEARCH"] += ["--time", _as_seconds(limit)] if limit else []
    words["SIGNALS"] = ["--signals", signals] if signals else []
    named = template.replace("FOLDER", folder).replace("NUMBER", folder.partition("_")[0])
    return [word for name in f"{named} SIGNALS".split() for word in words.get(name, [name])]


def _as_seconds(text: str) -> str:
    try:
        return f"{float(text):.10g}"
    except ValueError:
        raise CesError(f"'{text}' is no number; expected seconds") from None


@dataclass(frozen=True)
class DeskJob:
    """A job: its folder, number, command line, state (`running`, `done` and others) and how long it has run [s]."""

    path: Path
    number: int
    command: str
    state: str
    seconds: float

    @property
    def lines(self) -> str:
        """The program's last lines as a terminal shows them in the end; of signs of life in a row the last."""
        with (self.path / LOG).open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL_BYTES))
            text = file.read().decode("utf-8", "replace")
        rows = [row.rstrip("\r").rpartition("\r")[2] for row in text.split("\n")]
        pairs = zip(rows, [*rows[1:], ""], strict=True)
        return "\n".join(row for row, after in pairs if not (HEARTBEAT.match(row) and HEARTBEAT.match(after))).rstrip()


def read_job(path: Path) -> DeskJob:
    """Return the job in a folder; raises OSError."""
    command, log, status = path / COMMAND, path / LOG, path / STATUS
    word = status.read_text(encoding="utf-8").strip() if status.exists() else ""
    ended = STATES.get(word) or (word.replace("ended", "failed: status") if "ended" in word else "interrupted")
    state, end = (RUNNING, time.time()) if _is_locked(log) else (ended, log.stat().st_mtime)
    text, seconds = command.read_text(encoding="utf-8"), max(0.0, end - command.stat().st_mtime)
    return DeskJob(path, int(path.name.partition("_")[0]), text, state, seconds)


def _is_locked(path: Path) -> bool:
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


class Jobs:
    """The jobs of a folder; may be used by many threads."""

    def __init__(self, root: Path) -> None:
        self._root, self._lock = root, threading.Lock()

    def list(self) -> list[DeskJob]:
        """Return all jobs, the newest first."""
        paths = (path for path in self._root.iterdir() if NAME.fullmatch(path.name) and not path.is_symlink())
        jobs = (read_job(path) for path in paths if (path / COMMAND).is_file() and (path / LOG).is_file())
        return sorted(jobs, key=lambda job: -job.number)

    def next_folder(self, program: str) -> str:
        """Return the name of the folder of the next job, such as 03_identify; raises CesError while one runs."""
        if running := [job.number for job in self.list() if job.state == RUNNING]:
            raise CesError(f"job {running[0]} is running; wait for its end, or cancel it")
        matches = (NAME.fullmatch(path.name) for path in self._root.iterdir())
        return f"{max((int(match[1]) for match in matches if match), default=0) + 1:02d}_{program}"

    def start(self, folder: str, words: Sequence[str]) -> int:
        """Start `ces PROGRAM` in its folder; returns its number. Raises CesError if the folder is not the next."""
        with self._lock:
            path, program = self._root / folder, folder.partition("_")[2]
            if folder != self.next_folder(program):
                raise CesError(f"{folder} exists; go back to the page and press again")
            path.mkdir()
            (path / COMMAND).write_text(shlex.join(["ces", program, *words]), encoding="utf-8")
            run = ["sh", "-c", SCRIPT, str(path / STATUS), sys.executable, *START, program, *words]
            with (path / LOG).open("wb") as log:
                fcntl.flock(log, fcntl.LOCK_EX)
                Popen(run, stdin=DEVNULL, stdout=log, stderr=log, cwd=self._root, start_new_session=True).wait()
            return int(folder.partition("_")[0])

    def cancel(self, number: int) -> None:
        """End the processes of a job if they run; those that do not end are killed."""
        with self._lock:
            for log, status in ((job.path / LOG, job.path / STATUS) for job in self.list() if job.number == number):
                word, _, group = status.read_text(encoding="utf-8").partition(" ")
                for ending in (signal.SIGTERM, signal.SIGKILL) if word == "process" else ():
                    if _is_locked(log):
                        status.write_text(CANCELLED, encoding="utf-8")
                        os.killpg(int(group), ending)
                    end = time.monotonic() + GRACE_S
                    while _is_locked(log) and time.monotonic() < end:
                        time.sleep(0.05)
