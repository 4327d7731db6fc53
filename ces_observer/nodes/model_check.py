"""A program of its own: a model file's text on standard input, why it cannot be used on standard output.

A node has it run on a model that is to replace the one it runs with, because proving its stability, and inverting it
for a controller, may take seconds and would hold up the samples that arrive meanwhile. Exit status 0: use it, by its
inverse on standard output if that was asked for; 2: the reason is on standard output.
"""

from __future__ import annotations

import os
import resource
import sys

from ces_observer.control.model_inverse import ModelInverse
from ces_observer.errors import CesError, ModelError
from ces_observer.model import MAX_BYTES, Model, parse_model

PROVE, INVERT = "prove", "invert"  # what is to be done with the model
USER_ERROR = 2
MAX_CPU_S = 300
MAX_MEMORY_BYTES = 1 << 30  # bytes of address space: a model is small, whatever it claims
NICENESS = 15
MAX_REASON_LENGTH = 2000  # characters


def require_stable(model: Model, source: str) -> None:
    """Prove the model's stability anew, whatever its file claims; raises ModelError naming `source`."""
    if not model.is_stable():
        raise ModelError(
            f"{source}: {model.body.unproved}; identify it anew with a certificate, or set allow_uncertified: true to "
            "run it all the same"
        )


def main() -> int:
    """Check the model on standard input: the first argument names it in errors, the others say what is to be done."""
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
