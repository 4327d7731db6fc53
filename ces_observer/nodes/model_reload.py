"""Checks a model for a running node in a child process: proof of stability and inverse map, then a verdict.

Nothing here waits: `start` starts the child and returns, `poll` returns the verdict when the child has ended. That may
take seconds of one core, too long for the node itself.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import BinaryIO

from ces_observer.model import Model

LONGEST_S = 600.0  # a longer check is ended
PARENT = str(Path(__file__).resolve().parent.parent.parent)


@dataclass(frozen=True)
class Verdict:
    """The result of a check: the model, its origin, `error` if it cannot be used, and the `output` of the tasks."""

    model: Model
    source: str
    error: str
    output: str = ""


class ModelReload:
    """Checks one model at a time; a newer one replaces it."""

    def __init__(self) -> None:
        self._checked: tuple[Model, str] | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._output: BinaryIO | None = None
        self._began_s = 0.0

    def start(self, model: Model, source: str, tasks: Sequence[str]) -> None:
        """Start the `tasks` of model_check on `model`, named `source` in errors; without tasks there is no check.

        Raises OSError if no process can be started.
        """
        self.cancel()
        if tasks:
            self._output = tempfile.TemporaryFile()  # noqa: SIM115  # read after the child's end
            self._child = _start_check(model.to_json(), (source, *tasks), self._output)
        self._checked, self._began_s = (model, source), monotonic()

    def poll(self) -> Verdict | None:
        """Return the verdict once; None before the end of the check."""
        if self._checked is None:
            return None
        status = 0 if self._child is None else self._child.poll()
        if status is None and monotonic() - self._began_s < LONGEST_S:
            return None
        model, source = self._checked
        output = self._read_output()
        self.cancel()
        if status == 0:
            return Verdict(model, source, "", output)
        return Verdict(model, source, _reason(source, status, output))

    def cancel(self) -> None:
        """Cancel a check in progress."""
        self._checked = None
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._child = None
        if self._output is not None:
            self._output.close()
            self._output = None

    def _read_output(self) -> str:
        """Return the child's output."""
        if self._output is None:
            return ""
        self._output.seek(0)
        return self._output.read().decode("utf-8", "replace").strip()


def _reason(source: str, status: int | None, output: str) -> str:
    if status is None:
        return f"{source}: not checked within {LONGEST_S:g} s; expected a model this computer can prove stable"
    return output or f"{source}: its check ended with status {status}; check the file with `ces info`"


def _start_check(text: str, words: Sequence[str], output: BinaryIO) -> subprocess.Popen[bytes]:
    """Start the child with this very package; files replace pipes, at which one side might wait."""
    paths = [PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
    with tempfile.TemporaryFile() as model_file:
        model_file.write(text.encode())
        model_file.seek(0)
        return subprocess.Popen(
            [sys.executable, "-m", "ces_observer.nodes.model_check", *words],
            stdin=model_file,
            stdout=output,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )
