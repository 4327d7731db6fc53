"""A model on its way into a running observer: proved to be stable in a child process, then a verdict.

Nothing here waits: `start` hands the model over and returns, `poll` looks whether the child is done. Proving takes
anything from milliseconds to seconds of one core, which the samples that arrive meanwhile could not wait for.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from ces_observer.model import Model

LONGEST_S = 600.0  # a proof that takes longer is ended: the computer has no time for it
PARENT = str(Path(__file__).resolve().parent.parent.parent)


@dataclass(frozen=True)
class Verdict:
    """The end of a check: a model, where it came from, and in `error` why it cannot be used; empty if it can."""

    model: Model
    source: str
    error: str


class ModelReload:
    """At most one model being checked; a newer one takes its place."""

    def __init__(self) -> None:
        self._checked: tuple[Model, str] | None = None
        self._child: subprocess.Popen[bytes] | None = None
        self._began_s = 0.0

    def start(self, model: Model, source: str, *, prove: bool) -> None:
        """Begin to check `model`, called `source` in errors; without `prove` there is nothing left to check.

        Raises OSError if no process can be started.
        """
        self.cancel()
        if prove:
            self._child = _proving(model.to_json(), source)
        self._checked, self._began_s = (model, source), monotonic()

    def poll(self) -> Verdict | None:
        """Return the verdict once, when there is one."""
        if self._checked is None:
            return None
        status = 0 if self._child is None else self._child.poll()
        if status is None and monotonic() - self._began_s < LONGEST_S:
            return None
        model, source = self._checked
        verdict = Verdict(model, source, "" if status == 0 else f"{self._reason(source, status)}")
        self.cancel()
        return verdict

    def cancel(self) -> None:
        """End a check that is under way."""
        self._checked = None
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            if self._child.stdout is not None:
                self._child.stdout.close()
            self._child = None

    def _reason(self, source: str, status: int | None) -> str:
        if status is None:
            return f"{source}: stability not proved within {LONGEST_S:g} s; expected a model this computer can prove"
        stdout = self._child.stdout if self._child is not None else None
        told = stdout.read().decode("utf-8", "replace").strip() if stdout is not None else ""
        return told or f"{source}: the check of its stability ended with status {status}; see what `ces info` says"


def _proving(text: str, source: str) -> subprocess.Popen[bytes]:
    """Start the child; it finds this very package, and reads from a file as a pipe might make this process wait."""
    paths = [PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
    with tempfile.TemporaryFile() as given:
        given.write(text.encode())
        given.seek(0)
        return subprocess.Popen(
            [sys.executable, "-m", "ces_observer.nodes.model_check", source],
            stdin=given,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )
