"""Where the functions of `ces_observer.tick` run: the compiled core if the installation has it, else their source.

`bind` gives a function with its arrays, as fast as this installation can call it. The compiled core is used if it was
made from the tick that is here, and rounds like it; CES_PLAIN_TICK=1 in the environment forbids it.
"""

from __future__ import annotations

import hashlib
import os
from array import array
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ces_observer import tick
from ces_observer.tick.run import rounding_sample

SEEDS = range(1, 9)  # of the self-test


@cache
def tick_digest() -> str:
    """Return a digest of the source of the tick."""
    digest = hashlib.sha256()
    for path in sorted(Path(tick.__path__[0]).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _compiled() -> tuple[Any, str]:
    """Return the compiled core, None if it is not to be used, and which of both runs, in words."""
    if os.environ.get("CES_PLAIN_TICK") == "1":
        return None, "plain Python: CES_PLAIN_TICK is set"
    try:
        core = import_module("ces_observer._tick")
    except ImportError:
        return None, "plain Python: no compiled core in this installation"
    if tick_digest() != core.DIGEST:
        return None, "plain Python: the compiled core is of another version; build again"
    compiled_sample = core.bind(rounding_sample.__name__)
    if any(compiled_sample(seed) != rounding_sample(seed) for seed in SEEDS):
        return None, "plain Python: the compiled core rounds otherwise (-ffp-contract=off?)"
    return core, "compiled core"


def description() -> str:
    """Return what runs the tick, and why it is not the compiled core, for diagnostics."""
    return _compiled()[1]


def floats(values: Iterable[float]) -> Sequence[float]:
    """Return numbers as an array that bound functions take."""
    return array("d", values) if _compiled()[0] else list(values)


def ints(values: Iterable[int]) -> Sequence[int]:
    """Return whole numbers as an array that bound functions take."""
    return array("q", values) if _compiled()[0] else list(values)


def bind(function: Callable[..., Any], *arrays: Sequence[Any]) -> Callable[..., Any]:
    """Return `function` of the tick with its first arguments, which are arrays made by `floats` and `ints`."""
    core = _compiled()[0]
    if core and function.__name__ in core.FUNCTIONS and function.__module__.startswith(f"{tick.__name__}."):
        return core.bind(function.__name__, *arrays)  # type: ignore[no-any-return]
    return partial(function, *arrays)
