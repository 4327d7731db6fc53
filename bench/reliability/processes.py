"""The processes of a campaign: the observer as a user starts it, and the replaceable source of the ride."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


class ObserverProcess:
    """The node in its own process, with its log in a file."""

    def __init__(self, namespace: str, parameters: Mapping[str, object], log: Path) -> None:
        self._log = log
        words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        with log.open("w", encoding="utf-8") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "ces_observer.nodes.observer", *ros_args(namespace), *words],
                cwd=ROOT,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def is_running(self) -> bool:
        return self.process.poll() is None

    def log(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def end(self, timeout_s: float = 15.0) -> list[str]:
        """Interrupt the observer like Ctrl-C; return the violations at its end."""
        if self.is_running():
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(signal.SIGINT)
        try:
            status = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return [f"the observer did not end within {timeout_s:g} s of SIGINT"]
        wrong = [f"the observer ended with status {status}"] if status else []
        return wrong + (["its log contains a traceback"] if "Traceback" in self.log() else [])


class SourceProcess:
    """The source's process; `restart` kills it and starts another."""

    def __init__(self, namespace: str, simulated_ns: int | None) -> None:
        self._namespace = namespace
        self._simulated_ns = simulated_ns
        self._start()

    def wait_for_event(self, event: str, timeout_s: float = 20.0) -> dict[str, Any]:
        """Wait for an event of the source and return it; earlier events are dropped. Raises TimeoutError."""
        end = time.monotonic() + timeout_s
        while True:
            try:
                received = self._events.get(timeout=max(0.0, end - time.monotonic()))
            except queue.Empty:
                raise TimeoutError(f"the source did not report '{event}' within {timeout_s:g} s") from None
            if received["event"] == event:
                return dict(received)

    def send(self, **command: object) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(command) + "\n")
        self.process.stdin.flush()

    def stamp_now(self) -> int:
        """Return the stamp [ns] of the sample that is due now."""
        return self._began["good_ns"] + time.time_ns() - self._began["at_ns"]

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()

    def restart(self) -> dict[str, Any]:
        """Start another source and return its event `running`."""
        if self._simulated_ns is not None:
            self._simulated_ns = self.stamp_now()
        self._start()
        return self._began

    def _start(self) -> None:
        simulated = [] if self._simulated_ns is None else [f"--simulated-ns={self._simulated_ns}"]
        words = [sys.executable, str(HERE / "source.py"), *simulated, *ros_args(self._namespace)]
        paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": paths},
            start_new_session=True,
        )
        self._events: queue.Queue[dict[str, Any]] = queue.Queue()
        threading.Thread(target=_listen, args=(self.process, self._events), daemon=True).start()
        self._began = self.wait_for_event("running")


def _listen(process: subprocess.Popen[str], events: queue.Queue[dict[str, Any]]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        events.put(json.loads(line))


def ros_args(namespace: str) -> list[str]:
    """Return the ROS arguments: the campaign's own namespace and clock."""
    return ["--ros-args", "-r", f"__ns:={namespace}", "-r", f"/clock:={namespace}/clock"]
