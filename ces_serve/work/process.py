"""One piece of work in a process of its own: a task goes in, messages come out; it ends when nobody waits for it."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress
from typing import Any

Message = dict[str, Any]
WORKER = "ces_serve.work.worker"
HEARTBEAT_S = 1.0
MAX_LINE = 64_000_000
RESULT, FAILED = "result", "failed"


def do_work(task: Mapping[str, Any], limit_s: float) -> Generator[Message, None, None]:
    """Yield the messages of a task, an empty one at least every second; the last has a key RESULT or FAILED.

    The process ends with the generator: when the result is there, after `limit_s` seconds, or when it is closed. Its
    temporary files, such as the decompressed copy of a bag, go with it.
    """
    with tempfile.TemporaryDirectory(prefix="ces-serve-") as scratch:
        process = _start(scratch)
        try:
            _send(process, task)
            yield from _messages(process, limit_s)
        finally:
            _end(process)


def _messages(process: subprocess.Popen[bytes], limit_s: float) -> Iterator[Message]:
    lines: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_read_lines, args=(process, lines), daemon=True).start()
    end_s = time.monotonic() + limit_s
    while True:
        left_s = end_s - time.monotonic()
        if left_s <= 0.0:
            yield {FAILED: f"stopped: it took longer than {limit_s:.0f} s"}
            return
        try:
            line = lines.get(timeout=min(HEARTBEAT_S, left_s))
        except queue.Empty:
            yield {}
            continue
        if not line:
            yield {FAILED: f"the process ended without a result (status {process.wait()})"}
            return
        message: Message = json.loads(line)
        yield message
        if RESULT in message or FAILED in message:
            return


def _start(scratch: str) -> subprocess.Popen[bytes]:
    """Start a process in a group of its own, so that Ctrl-C at the terminal reaches the server alone."""
    command, pipe = [sys.executable, "-m", WORKER], subprocess.PIPE
    return subprocess.Popen(
        command, stdin=pipe, stdout=pipe, start_new_session=True, env={**os.environ, "TMPDIR": scratch}
    )


def _send(process: subprocess.Popen[bytes], task: Mapping[str, Any]) -> None:
    """Send the task; the open end of its input also shows the process that this one is there."""
    assert process.stdin is not None
    with suppress(BrokenPipeError):
        process.stdin.write(json.dumps(task).encode() + b"\n")
        process.stdin.flush()


def _read_lines(process: subprocess.Popen[bytes], lines: queue.Queue[bytes]) -> None:
    assert process.stdout is not None
    with suppress(ValueError, OSError):  # closed by `_end`
        while line := process.stdout.readline(MAX_LINE):
            lines.put(line)
    lines.put(b"")


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()
