"""The server's side of the live view: starts the listening process when someone looks, and shares its messages.

rclpy runs in that process alone, so that nothing of ROS can take the server down. Without ROS the reason is a message.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

Message = dict[str, Any]
LISTENER = "ces_serve.live.node"
MAX_WAITING = 400  # messages for a client that reads too slowly: 20 s; older ones are dropped
HEARTBEAT_S = 1.0
CHECK_S = 20.0
ROS = "ROS_DISTRO"  # set by a sourced ROS 2
MISSING, ENDED, TOPICS = "missing", "ended", "topics"
NOT_SOURCED = "ROS 2 is not sourced here: source it and start ces serve again to see a running observer"
NO_RCLPY = "ROS 2 is sourced, but neither the Python of ces serve nor python3 can import rclpy and its messages"
PACKAGES = str(Path(__file__).resolve().parents[2])  # come last, so that rclpy finds the libraries of its own Python
WITH_PACKAGES = "import sys; sys.path.append(sys.argv.pop(1)); "
CHECK = f"{WITH_PACKAGES}import rclpy, sensor_msgs.msg, diagnostic_msgs.msg, ces_serve.live.batches"
RUN = f"{WITH_PACKAGES}from runpy import run_module; run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"


class ObserverLink:
    """Shares the messages of one listening process among clients; it runs while there is at least one."""

    def __init__(self, observer: str = "") -> None:
        self._observer = observer
        self._lock = threading.Lock()
        self._clients: set[queue.Queue[Message]] = set()
        self._process: subprocess.Popen[str] | None = None
        self._topics: Message = {}  # the newest message that says which topics there are

    def messages(self) -> Generator[Message, None, None]:
        """Yield messages as they come, an empty one at least every second; MISSING or ENDED is the last."""
        python = find_python()
        if python is None:
            yield {MISSING: NO_RCLPY if ROS in os.environ else NOT_SOURCED}
            return
        waiting: queue.Queue[Message] = queue.Queue(MAX_WAITING)
        self._join(waiting, python)
        try:
            while True:
                try:
                    message = waiting.get(timeout=HEARTBEAT_S)
                except queue.Empty:
                    message = {}
                yield message
                if ENDED in message:
                    return
        finally:
            self._leave(waiting)

    def close(self) -> None:
        """End the listening process."""
        with self._lock:
            self._stop()

    def _join(self, waiting: queue.Queue[Message], python: str) -> None:
        """Add a client, and start the process for the first one."""
        with self._lock:
            self._clients.add(waiting)
            if self._process is not None:
                waiting.put_nowait(self._topics)
                return
            command = [python, "-c", RUN, PACKAGES, LISTENER, self._observer]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, start_new_session=True)
            threading.Thread(target=self._share, args=(self._process,), daemon=True).start()

    def _leave(self, waiting: queue.Queue[Message]) -> None:
        with self._lock:
            self._clients.discard(waiting)
            if not self._clients:
                self._stop()

    def _stop(self) -> None:
        process, self._process, self._topics = self._process, None, {}
        if process is not None:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def _share(self, process: subprocess.Popen[str]) -> None:
        """Give each line of the process to all clients, until it ends."""
        assert process.stdout is not None
        for line in process.stdout:
            with suppress(ValueError):
                self._put(json.loads(line), process)
        status = process.wait()
        self._put({ENDED: f"the listening process ended with status {status}; see the terminal of ces serve"}, process)

    def _put(self, message: Message, process: subprocess.Popen[str]) -> None:
        """Give a message to all clients, unless its process has been replaced."""
        with self._lock:
            if self._process is not process:
                return
            self._topics = message if TOPICS in message else self._topics
            for waiting in self._clients:
                with suppress(queue.Empty):
                    if waiting.full():
                        waiting.get_nowait()
                with suppress(queue.Full):
                    waiting.put_nowait(message)
            if ENDED in message:
                self._process, self._topics = None, {}


@cache
def find_python() -> str | None:
    """Return a Python that has rclpy: this one, or the `python3` of the sourced ROS 2; None without ROS."""
    if ROS not in os.environ:
        return None
    candidates = dict.fromkeys(filter(None, (sys.executable, shutil.which("python3"), "/usr/bin/python3")))
    return next((python for python in candidates if _has_rclpy(python)), None)


def _has_rclpy(python: str) -> bool:
    command = [python, "-c", CHECK, PACKAGES]
    try:
        done = subprocess.run(command, capture_output=True, check=False, timeout=CHECK_S)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0
