"""The worker process of the node `identify`, as the node uses it: start it, poll its messages, stop it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from queue import Empty, SimpleQueue
from typing import IO, Any

WORKER = "ces_cli.identify.worker"
WARNING, EXIT_STATUS = "warning", "exit_status"
END_S = 5.0  # maximum wait for a killed process


class IdentifyProcess:
    """An identification in a separate process and session, so that a terminal's Ctrl-C does not reach it.

    It ends with the node, however the node ends, because its standard input closes then.
    """

    def __init__(self, words: Sequence[str]) -> None:
        self._messages: SimpleQueue[dict[str, Any]] = SimpleQueue()
        self._process = subprocess.Popen(
            [sys.executable, "-m", WORKER, *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )
        assert self._process.stdout is not None and self._process.stderr is not None
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
            self._messages.put(_parse_message(line))
        self._warnings.join()
        self._messages.put({EXIT_STATUS: self._process.wait()})

    def _read_warnings(self, stream: IO[str]) -> None:
        for line in stream:
            if line.strip():
                self._messages.put({WARNING: line.rstrip().removeprefix("warning: ")})


def _parse_message(line: str) -> dict[str, Any]:
    """Return the message in a line, a warning for one that is none."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        message = None
    return message if isinstance(message, dict) else {WARNING: f"not a message of the search: {line.rstrip()[:200]}"}
