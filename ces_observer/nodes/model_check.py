"""Checks a model for a running node in a child process: proof of stability and inverse map, then a verdict.

They may take seconds, too long for the node itself. Nothing in the node waits: `ModelReload.start` starts the child and
returns, `poll` returns the verdict when the child has ended. A child that hangs, dies, is killed or answers nonsense is
a verdict with an error.

The child runs this module as a program, with the model file on standard input. Exit status 0: the model can be used,
and standard output has one line of JSON: the model's hash, the tasks that were done, and its inverse if requested; 2:
the reason why not is there. The program limits itself, ends with the node, and is the first process that the kernel
kills when memory is short.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import BinaryIO

from ces_observer import core
from ces_observer.control.inverse_map import ModelInverse
from ces_observer.errors import CesError, ModelError
from ces_observer.limits import FileLimits, NodeLimits
from ces_observer.model import Model, parse_model

PROVE, INVERT = "prove", "invert"  # the tasks
USER_ERROR = 2
CHECK = ("-m", "ces_observer.nodes.model_check")
PARENT = str(Path(__file__).resolve().parent.parent.parent)
MAX_ANSWER_BYTES = 1 << 23
NICENESS = 15
OOM_SCORE = "1000"  # killed before any other process
PR_SET_PDEATHSIG = 1
MAX_REASON_LENGTH = 2000  # characters


def require_stable(model: Model, source: str) -> None:
    """Prove the stability of a model, whatever its file claims; raises ModelError naming `source`."""
    if not model.is_stable():
        raise ModelError(
            f"{source}: {model.body.unproved}; identify it again with a certificate, or set allow_uncertified: true "
            "to run it without"
        )


def describe_model(model: Model) -> str:
    """Return a sentence about a model for the log: its size, and what holds for inputs outside its envelope.

    Only a structure that extrapolates is proved here: the proof of a damper takes about 0.1 s.
    """
    delay = f"; delay_s {model.sampling.delay_s:g}"
    text = f"{model.structure}, {model.size}{delay}; inputs outside the envelope are {model.body.outside}"
    if not model.body.extrapolates:
        return text
    bounds = "; ".join(f"{name} {value}".strip() for name, value in model.certify().rows)
    return f"{text}; proved: {bounds}"


def model_facts(model: Model) -> dict[str, str]:
    """Return the key-value pairs that name a model and what computes it, in diagnostics and on `~/model_status`."""
    delay = f"{model.sampling.delay_s:g}"
    return {"model sha256": model.digest(), "delay_s": delay, "computed by": core.description()}


@dataclass(frozen=True)
class Verdict:
    """The result of a check: the model, its origin, `error` if it cannot be used, the inverse if requested."""

    model: Model
    source: str
    error: str
    inverse: str = ""


class ModelReload:
    """Checks one model at a time, for at most `longest_s`, with the arguments `program` of this Python."""

    def __init__(self, program: Sequence[str] = CHECK, longest_s: float = NodeLimits.MAX_CHECK_S) -> None:
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
            with tempfile.TemporaryFile() as model_file:  # files, as a pipe might make one side wait
                model_file.write(model.to_json().encode())
                model_file.seek(0)
                self._child = _start_child((*self._program, source, *tasks), model_file, self._output)
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
        output = ""
        if self._output is not None:
            self._output.seek(0)
            output = self._output.read(MAX_ANSWER_BYTES).decode("utf-8", "replace").strip()
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


def _require_success(status: int | None, output: str, longest_s: float) -> None:
    """Raise ModelError with the reason, if the child did not end with status 0."""
    if status == 0:
        return
    if status == USER_ERROR and output:
        line = output.splitlines()[0][:MAX_REASON_LENGTH]
        raise ModelError("".join(one if one.isprintable() else "?" for one in line))
    reasons = {
        None: f"not checked within {longest_s:g} s; expected a model this computer can prove stable",
        -signal.SIGXCPU: f"its check took more than {NodeLimits.MAX_CPU_S} s of processor time",
        -signal.SIGKILL: "its check was killed, as the kernel does when memory is short; free some and try again",
    }
    other = f"its check ended with status {status}; check the file with `ces info`"
    raise ModelError(reasons.get(status, other))


def _read_answer(output: str, model: Model, tasks: Sequence[str]) -> str:
    """Return the inverse in the child's answer; raises ModelError if it is not an answer for this model and tasks."""
    try:
        answer = json.loads(output)
        if (answer["sha256"], answer["tasks"]) == (model.digest(), list(tasks)):
            return str(answer["inverse"])
    except (ValueError, TypeError, KeyError, RecursionError):
        pass
    raise ModelError("its check gave an answer that is none; try again, or check the file with `ces info`")


def _start_child(words: Sequence[str], stdin: BinaryIO, stdout: BinaryIO) -> subprocess.Popen[bytes]:
    """Start this Python with the arguments `words`, so that it finds this very package; raises OSError."""
    paths = [PARENT, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, *words]
    return subprocess.Popen(command, stdin=stdin, stdout=stdout, stderr=subprocess.DEVNULL, env=environment)


def main() -> int:
    """Check the model on standard input; the first argument names it in errors, the others are the tasks."""
    _limit_this_process()
    source, *tasks = sys.argv[1:]
    try:
        print(_check(source, tasks))
        return 0
    except (CesError, UnicodeDecodeError) as error:
        reason = str(error)
    except MemoryError:
        reason = f"{source}: its check needs more than {NodeLimits.MAX_MEMORY_BYTES >> 20} MiB of memory"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        reason = f"{source}: its check failed unexpectedly at {where}: {type(error).__name__}: {error}"
    print((reason.splitlines() or [source])[0][:MAX_REASON_LENGTH])
    return USER_ERROR


def _check(source: str, tasks: Sequence[str]) -> str:
    text = sys.stdin.buffer.read(4 * FileLimits.MAX_BYTES).decode("utf-8")
    model = parse_model(text, source)
    if PROVE in tasks:
        require_stable(model, source)
    inverse = ModelInverse.from_model(model, source).to_json() if INVERT in tasks else ""
    return json.dumps({"sha256": model.digest(), "tasks": list(tasks), "inverse": inverse})


def _limit_this_process() -> None:
    with suppress(OSError, AttributeError):  # the node may run under SCHED_FIFO
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(NICENESS)
    resource.setrlimit(resource.RLIMIT_CPU, (NodeLimits.MAX_CPU_S, NodeLimits.MAX_CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (NodeLimits.MAX_MEMORY_BYTES, NodeLimits.MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_ANSWER_BYTES, MAX_ANSWER_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main())
