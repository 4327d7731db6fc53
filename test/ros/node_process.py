"""The observer node as a process of its own, as a user starts it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from patience import PATIENCE_S

ORDERLY_S = 15.0  # for a node to end in order after its test
ROOT = Path(__file__).resolve().parent.parent.parent


class NodeProcess:
    """A command in its own process group, whose output is kept."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str] | None = None) -> None:
        self._process = subprocess.Popen(
            command,
            cwd=ROOT,
            env={**os.environ, **(env or {})},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    @classmethod
    def from_source(
        cls, namespace: str, parameters: Mapping[str, object], module: str = "ces_observer.nodes.observer"
    ) -> NodeProcess:
        """Start a node from this checkout."""
        return cls([sys.executable, "-m", module, *ros_args(namespace, parameters)])

    @property
    def pid(self) -> int:
        return self._process.pid

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Signal the whole group, as a terminal does on Ctrl-C."""
        os.killpg(self._process.pid, number)

    def ended(self, timeout_s: float = PATIENCE_S) -> tuple[int, str]:
        """Wait for the end; return exit status and output."""
        output, _ = self._process.communicate(timeout=timeout_s)
        return self._process.returncode, output

    def is_running(self) -> bool:
        return self._process.poll() is None

    def kill(self) -> None:
        """End whatever is left of the group, in order if it can: a reader that does not say goodbye is waited for."""
        if self.is_running():
            self.interrupt()
            try:
                self.ended(ORDERLY_S)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.communicate()


def ros_args(namespace: str, parameters: Mapping[str, object]) -> list[str]:
    """Return the command line's ROS part."""
    words = ["--ros-args", "-r", f"__ns:={namespace}", "-r", f"/clock:={namespace}/clock"]
    for name, value in parameters.items():
        words += ["-p", f"{name}:={value}"]
    return words
