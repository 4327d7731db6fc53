"""A model on its way into a running node: proved to be stable and inverted in a child process, then a verdict.

Nothing here waits: `start` hands the model over and returns, `poll` looks whether the child is done. That takes
anything from milliseconds to seconds of one core, which the samples that arrive meanwhile could not wait for.
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

LONGEST_S = 600.0  # a check that takes longer is ended: the computer has no time for it
PARENT = str(Path(__file__).resolve().parent.parent.parent)


@dataclass(frozen=True)
class Verdict:
    """The end of a check: a model, where it came from, and in `error` why it cannot be used; empty if it can.

    `output` is what the check was asked to make of the model, as text.
    """

    model: Model
    source: str
    error: str
    output: str = ""


class ModelReload:
    """At most one model being checked; a newer one takes its place."""

    def __init__(self) -> None:
        self._checked: tuple[Model, str] | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._output: BinaryIO | None = None
        self._began_s = 0.0

    def start(self, model: Model, source: str, tasks: Sequence[str]) -> None:
        """Begin to do `tasks` of model_check with `model`, called `source` in errors; with none there is no check.

        Raises OSError if no process can be started.
        """
        self.cancel()
        if tasks:
            self._output = tempfile.TemporaryFile()  # noqa: SIM115  # read when the child is done; it never waits for that
            self._child = _start_check(model.to_json(), (source, *tasks), self._output)
        self._checked, self._began_s = (model, source), monotonic()

    def poll(self) -> Verdict | None:
        """Return the verdict once, when there is one."""
        if self._checked is None:
            return None
        status = 0 if self._child is None else self._child.poll()
        if status is None and monotonic() - self._began_s < LONGEST_S:
            return None
        model, source = self._checked
        told = self._read_output()
        self.cancel()
        if status == 0:
            return Verdict(model, source, "", told)
        return Verdict(model, source, _reason(source, status, told))

    def cancel(self) -> None:
        """End a check that is under way."""
        self._checked = None
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._child = None
        if self._output is not None:
            self._output.close()
            self._output = None

    def _read_output(self) -> str:
        """Return what the child has told."""
        if self._output is None:
            return ""
        self._output.seek(0)
        return self._output.read().decode("utf-8", "replace").strip()


def _reason(source: str, status: int | None, output: str) -> str:
    if status is None:
        return f"{source}: not checked within {LONGEST_S:g} s; expected a model this computer can prove stable"
    return output or f"{source}: its check ended with status {status}; see what `ces info` says"


def _start_check(text: str, words: Sequence[str], output: BinaryIO) -> subprocess.Popen[bytes]:
    """Start the child; it finds this very package, and files stand in for pipes, which might make one side wait."""
    paths = [PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
    with tempfile.TemporaryFile() as given:
        given.write(text.encode())
        given.seek(0)
        return subprocess.Popen(
            [sys.executable, "-m", "ces_observer.nodes.model_check", *words],
            stdin=given,
            stdout=output,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )
