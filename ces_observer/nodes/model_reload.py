"""Checks a model for a running node in a child process: proof of stability and inverse map, then a verdict.

Nothing here waits: `start` starts the child and returns, `poll` returns the verdict when the child has ended. That may
take seconds of one core, too long for the node itself. The child's own limits are in model_check. A child that hangs,
dies, is killed or answers nonsense is a verdict with an error.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import BinaryIO

from ces_observer.errors import ModelError
from ces_observer.model import Model
from ces_observer.nodes.model_check import MAX_ANSWER_BYTES, MAX_CPU_S, MAX_REASON_LENGTH, USER_ERROR

LONGEST_S = 600.0  # a longer check is ended
CHECK = ("-m", "ces_observer.nodes.model_check")
PARENT = str(Path(__file__).resolve().parent.parent.parent)


@dataclass(frozen=True)
class Verdict:
    """The result of a check: the model, its origin, `error` if it cannot be used, the inverse if requested."""

    model: Model
    source: str
    error: str
    inverse: str = ""


class ModelReload:
    """Checks one model at a time, for at most `longest_s`, with the arguments `program` of this Python."""

    def __init__(self, program: Sequence[str] = CHECK, longest_s: float = LONGEST_S) -> None:
        self._program, self._longest_s = tuple(program), longest_s
        self._checked: tuple[Model, str, tuple[str, ...]] | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._killed: list[subprocess.Popen[bytes]] = []
        self._output: BinaryIO | None = None
        self._began_s = 0.0

    def start(self, model: Model, source: str, tasks: Sequence[str]) -> None:
        """Start the `tasks` of model_check on `model`, named `source` in errors; without tasks there is no check.

        It replaces a check in progress. Raises OSError if no process can be started.
        """
        self.cancel()
        if tasks:
            self._output = tempfile.TemporaryFile()  # noqa: SIM115  # read after the child's end
            words = (*self._program, source, *tasks)
            self._child = _start_child(words, model.to_json(), self._output)
        self._checked, self._began_s = (model, source, tuple(tasks)), monotonic()

    def poll(self) -> Verdict | None:
        """Return the verdict once; None before the end of the check."""
        self._killed = [child for child in self._killed if child.poll() is None]
        if self._checked is None:
            return None
        status = 0 if self._child is None else self._child.poll()
        if status is None and monotonic() - self._began_s < self._longest_s:
            return None
        model, source, tasks = self._checked
        output = self._read_output()
        self.cancel()
        try:
            _require_success(status, output, self._longest_s)
            return Verdict(model, source, "", _read_answer(output, model, tasks) if tasks else "")
        except ModelError as error:
            text = str(error)
            return Verdict(model, source, text if text.startswith(source) else f"{source}: {text}")

    def cancel(self) -> None:
        """Cancel a check in progress, without waiting for the end of its child."""
        self._checked = None
        if self._child is not None:
            self._child.kill()
            self._killed.append(self._child)
            self._child = None
        if self._output is not None:
            self._output.close()
            self._output = None

    def _read_output(self) -> str:
        """Return the child's output, as far as it may be long."""
        if self._output is None:
            return ""
        self._output.seek(0)
        return self._output.read(MAX_ANSWER_BYTES).decode("utf-8", "replace").strip()


def _require_success(status: int | None, output: str, longest_s: float) -> None:
    """Raise ModelError with the reason, if the child did not end with status 0."""
    if status is None:
        raise ModelError(f"not checked within {longest_s:g} s; expected a model this computer can prove stable")
    if status == USER_ERROR and output:
        line = output.splitlines()[0][:MAX_REASON_LENGTH]
        raise ModelError("".join(one if one.isprintable() else "?" for one in line))
    if status == -signal.SIGXCPU:
        raise ModelError(f"its check took more than {MAX_CPU_S} s of processor time")
    if status == -signal.SIGKILL:
        raise ModelError("its check was killed, as the kernel does when memory is short; free some and try again")
    if status < 0:
        raise ModelError(f"its check was ended by signal {-status}; check the file with `ces info`")
    if status > 0:
        raise ModelError(f"its check ended with status {status}; check the file with `ces info`")


def _read_answer(output: str, model: Model, tasks: Sequence[str]) -> str:
    """Return the inverse in the child's answer; raises ModelError if it is not an answer for this model and tasks."""
    try:
        answer = json.loads(output)
        if (answer["sha256"], answer["tasks"]) == (model.digest(), list(tasks)):
            return str(answer["inverse"])
    except (ValueError, TypeError, KeyError, RecursionError):
        pass
    raise ModelError("its check gave an answer that is none; try again, or check the file with `ces info`")


def _start_child(words: Sequence[str], text: str, output: BinaryIO) -> subprocess.Popen[bytes]:
    """Start the child with this very package; files replace pipes, at which one side might wait."""
    paths = [PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
    with tempfile.TemporaryFile() as model_file:
        model_file.write(text.encode())
        model_file.seek(0)
        return subprocess.Popen(
            [sys.executable, *words],
            stdin=model_file,
            stdout=output,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )
