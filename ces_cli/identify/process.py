"""The worker process of the node `identify`, as the node uses it, and the progress that its messages tell."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import IO, Any

STARTING, READING, SEARCHING, WRITING, DONE = "starting", "reading", "searching", "writing", "done"
LINES = {
    STARTING: "starting",
    READING: "reading the recordings",
    SEARCHING: "searching: no model yet",
    WRITING: "refitting, evaluating and writing the best model",
    DONE: "done",
}


class SearchState:
    """The stage, the best cost so far and the elapsed time; `error` is why the process failed, if it did."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._began_s = clock_s()
        self._limits: Mapping[str, Any] = {}
        self._best: Mapping[str, Any] = {}
        self.stage = STARTING
        self.error = ""
        self.changed = self.changed_stage = True

    def update(self, message: Mapping[str, Any]) -> None:
        """Process a message: a stage, a better model, or an error."""
        self.changed = True
        if "stage" in message:
            self.stage, self.changed_stage = message["stage"], True
            self._began_s = self._clock_s()
            self._limits = message if "starts" in message else self._limits
        elif "error" in message:
            self.error = message["error"]
        else:
            self._best = message

    def clear_changes(self) -> None:
        """Mark all changes as published."""
        self.changed = self.changed_stage = False

    def as_status(self) -> tuple[str, dict[str, str]]:
        """Return a line and values by name: stage, its time [s], share of the search, cost [%], size, starts done.

        If the search ends before its work is done, the share jumps to 1.
        """
        elapsed_s, searching, share = self._clock_s() - self._began_s, self.stage == SEARCHING, 0.0
        if self._limits:
            share = self._best.get("share", 0.0) if searching else 1.0
        line, values = (
            LINES[self.stage],
            {"stage": self.stage, "elapsed [s]": f"{elapsed_s:.1f}", "share": f"{share:.3f}"},
        )
        if self._limits and self._best:
            cost, size, ended = (self._best[key] for key in ("cost", "size", "ended"))
            values |= {"J [%]": f"{cost:.4f}", "size": str(size), "starts ended": str(ended)}
            if searching:
                done = f"{ended} of {self._limits['starts']} starts done, {elapsed_s:.0f} s"
                line = f"searching: selection cost J = {cost:.2f} %, size {size}, {done}"
        return line, values


WORKER = "ces_cli.identify.worker"
WARNING, EXIT_STATUS = "warning", "exit_status"
END_S = 5.0  # maximum wait for a killed process


class IdentifyProcess:
    """An identification in a separate process and session, so that a terminal's Ctrl-C does not reach it.

    It ends with the node, however the node ends, because its standard input closes then.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        """Begin to identify what the values of options by name ask for."""
        self._messages: SimpleQueue[dict[str, Any]] = SimpleQueue()
        self._process = subprocess.Popen(
            [sys.executable, "-m", WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )
        assert self._process.stdin and self._process.stdout and self._process.stderr
        with suppress(BrokenPipeError):  # it has ended; its exit status follows
            self._process.stdin.write(json.dumps(given) + "\n")
            self._process.stdin.flush()
        self._warnings = threading.Thread(target=self._read_warnings, args=(self._process.stderr,), daemon=True)
        self._warnings.start()
        threading.Thread(target=self._read_output, args=(self._process.stdout,), daemon=True).start()

    def read_messages(self) -> Iterator[dict[str, Any]]:
        """Yield the messages of ces_cli.identify.worker since the last call.

        A `warning` is a line of its standard error; `exit_status` is the last message.
        """
        while True:
            try:
                yield self._messages.get_nowait()
            except Empty:
                return

    def interrupt(self) -> None:
        """Stop the search with the best model so far."""
        self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Kill the process and wait until it has ended."""
        self._process.kill()
        self._process.wait(END_S)

    def _read_output(self, stream: IO[str]) -> None:
        for line in stream:
            try:
                message = json.loads(line)
            except (ValueError, RecursionError):
                message = None
            if not isinstance(message, dict):
                message = {WARNING: f"not a message of the search: {line.rstrip()[:200]}"}
            self._messages.put(message)
        self._warnings.join()
        self._messages.put({EXIT_STATUS: self._process.wait()})

    def _read_warnings(self, stream: IO[str]) -> None:
        for line in stream:
            if line.strip():
                self._messages.put({WARNING: line.rstrip().removeprefix("warning: ")})
