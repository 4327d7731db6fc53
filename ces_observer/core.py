"""Where the functions of `ces_observer.tick` run: the compiled core if the installation has it, else their source.

`bind` gives a function with its arrays, as fast as this installation can call it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any


def floats(values: Iterable[float]) -> Sequence[float]:
    """Return numbers as an array that bound functions take."""
    return list(values)


def ints(values: Iterable[int]) -> Sequence[int]:
    """Return whole numbers as an array that bound functions take."""
    return list(values)


def bind(function: Callable[..., Any], *arrays: Sequence[Any]) -> Callable[..., Any]:
    """Return `function` of the tick with its first arguments, which are arrays made by `floats` and `ints`."""
    return partial(function, *arrays)
