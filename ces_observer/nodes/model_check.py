"""A program that checks a model file on standard input, for a node that shall change to the model.

The proof of stability and the inverse map for a controller may take seconds, too long for the node itself. Exit status
0: the model can be used, and standard output has one line of JSON: the model's hash, the tasks that were done, and its
inverse if requested; 2: the reason why not is there. The program limits itself, ends with the node, and is the first
process that the kernel kills when memory is short.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from ces_observer.control.model_inverse import ModelInverse
from ces_observer.errors import CesError, ModelError
from ces_observer.model import MAX_BYTES, Model, parse_model

PROVE, INVERT = "prove", "invert"  # the tasks
USER_ERROR = 2
MAX_CPU_S = 300
MAX_MEMORY_BYTES = 1 << 30  # bytes of address space: models are small
MAX_ANSWER_BYTES = 1 << 23
NICENESS = 15
OOM_SCORE = "1000"  # killed before any other process
PR_SET_PDEATHSIG = 1
MAX_REASON_LENGTH = 2000  # characters


def require_stable(model: Model, source: str) -> None:
    """Prove the model's stability, whatever its file claims; raises ModelError naming `source`."""
    if not model.is_stable():
        raise ModelError(
            f"{source}: {model.body.unproved}; identify it again with a certificate, or set allow_uncertified: true to "
            "run it without"
        )


def describe_model(model: Model) -> str:
    """Return a sentence about a model for the log: its size, and what holds for inputs outside its envelope.

    Only a structure that extrapolates is proved here: the proof of a damper takes about 0.1 s.
    """
    text = f"{model.structure}, {model.size}; inputs outside the envelope are {model.body.outside}"
    if not model.body.extrapolates:
        return text
    bounds = "; ".join(f"{name} {value}".strip() for name, value in model.certify().rows)
    return f"{text}; proved: {bounds}"


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
        reason = f"{source}: its check needs more than {MAX_MEMORY_BYTES >> 20} MiB of memory"
    except Exception as error:
        reason = f"{source}: its check failed unexpectedly: {type(error).__name__}: {error}"
    print((reason.splitlines() or [source])[0][:MAX_REASON_LENGTH])
    return USER_ERROR


def _check(source: str, tasks: Sequence[str]) -> str:
    """Return the answer; raises ModelError if the model cannot be used."""
    text = sys.stdin.buffer.read(4 * MAX_BYTES).decode("utf-8")
    model = parse_model(text, source)
    if PROVE in tasks:
        require_stable(model, source)
    inverse = ModelInverse.from_model(model, source).to_json() if INVERT in tasks else ""
    return json.dumps({"sha256": model.digest(), "tasks": list(tasks), "inverse": inverse})


def _limit_this_process() -> None:
    os.nice(NICENESS)
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_ANSWER_BYTES, MAX_ANSWER_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    sys.exit(main())
