"""A program that checks a model file on standard input, for a node that shall change to the model.

The proof of stability and the inverse map for a controller may take seconds, too long for the node itself. Exit status
0: the model can be used, and its inverse, if requested, is on standard output; 2: the reason why not is there.
"""

from __future__ import annotations

import os
import resource
import sys

from ces_observer.control.model_inverse import ModelInverse
from ces_observer.errors import CesError, ModelError
from ces_observer.model import MAX_BYTES, Model, parse_model

PROVE, INVERT = "prove", "invert"  # the tasks
USER_ERROR = 2
MAX_CPU_S = 300
MAX_MEMORY_BYTES = 1 << 30  # bytes of address space: models are small
NICENESS = 15
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
    os.nice(NICENESS)
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    source, *tasks = sys.argv[1:]
    try:
        text = sys.stdin.buffer.read(4 * MAX_BYTES).decode("utf-8")
        model = parse_model(text, source)
        if PROVE in tasks:
            require_stable(model, source)
        if INVERT in tasks:
            print(ModelInverse.from_model(model, source).to_json())
    except (CesError, UnicodeDecodeError) as error:
        print(str(error).splitlines()[0][:MAX_REASON_LENGTH])
        return USER_ERROR
    return 0


if __name__ == "__main__":
    sys.exit(main())
