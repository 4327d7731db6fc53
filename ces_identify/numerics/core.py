"""The functions of `ces_observer.tick`, compiled by Numba for the desk, and kernels that call them.

Numba's cache knows the file of a kernel, not those of the functions it calls. So all names here carry the digest of the
whole tick: whatever changes in it, everything that contains it is compiled anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from math import isfinite, nan
from types import FunctionType
from typing import Any, TypeVar

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

from ces_data.arrays import F, I, Mask
from ces_observer import tick
from ces_observer.core import tick_digest
from ces_observer.structures.structure import OperatingRange, Structure
from ces_observer.tick.arrays import part
from ces_observer.tick.mixture import structure_reset, structure_tick
from ces_observer.tick.model import HELD

Function = TypeVar("Function", bound=Callable[..., Any])
TICK = f"{tick.__name__}."


def with_names(function: Callable[..., Any], name: str, names: Mapping[str, Any]) -> Any:
    """Return a function with another name and other globals, compiled. Numba's cache takes no closures."""
    assert isinstance(function, FunctionType)
    clone = FunctionType(function.__code__, {**function.__globals__, **names}, name)
    clone.__module__ = function.__module__
    return core_kernel(clone)


@cache
def compile_tick(function: Callable[..., Any]) -> Any:
    """Return a function of the tick compiled by Numba, with all that it calls."""
    if function is part:
        return core_kernel(_part)
    names = {
        name: compile_tick(value)
        for name, value in function.__globals__.items()
        if name in function.__code__.co_names and getattr(value, "__module__", "").startswith(TICK) and callable(value)
    }
    return with_names(function, function.__name__, names)


def _part(array: Any, at: int) -> Any:
    """Do the work of `part` on a NumPy array; the desk runs mixtures by their members, so no pointer needs it."""
    return array[at:]


def core_kernel(function: Function) -> Function:
    """Compile a kernel that calls compiled functions of the tick; a decorator."""
    function.__qualname__ = f"{function.__name__}_{tick_digest()}"
    kernel: Function = njit(cache=True, nogil=True, error_model="numpy")(function)
    return kernel


@intrinsic
def pointer(_: Any, array: Any) -> Any:
    """Return the address of an array's elements, for kernels: functions of the tick are a fifth faster with it.

    They never count an index from the end, which Numba would check at every element, and need no shapes or strides.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), generate


def _run(numbers: F, counts: I, states: F, flags: I, inputs: F, segments: I, force: F, held: Mask) -> None:
    p, n, s, k = pointer(numbers), pointer(counts), pointer(states), pointer(flags)
    for segment in range(len(segments)):
        structure_reset(p, n, s, k)
        for i in range(segments[segment, 0], segments[segment, 1]):
            y = structure_tick(p, n, s, k, inputs[0, i], inputs[1, i], inputs[2, i])
            if not isfinite(y):
                force[i : segments[segment, 1]] = nan
                break
            force[i] = y
            held[i] = k[HELD] != 0


@cache
def batch_run(reset: Callable[..., None], tick: Callable[..., float]) -> Any:
    """Return `run(p, n, s, k, inputs, segments, force, held)`: the free run of a structure's functions over segments.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A]; `force` (ticks,) [N] and `held` (ticks,) receive
    the result. From a force that is not finite to the end of its segment, forces are NaN.
    """
    names = {"structure_reset": compile_tick(reset), "structure_tick": compile_tick(tick)}
    return with_names(_run, f"run_{tick.__name__}", names)


def run_batch(body: Structure, within: OperatingRange, inputs: F, segments: I) -> tuple[F, Mask]:
    """Return the force (ticks,) [N] of a structure's free run, and where it was held; see `batch_run`."""
    arrays = body.lay_out(within).arrays()
    p, n, s, k = (np.array(arrays.p), np.array(arrays.n, np.int64), np.array(arrays.s), np.array(arrays.k, np.int64))
    force, held = np.zeros(inputs.shape[1]), np.zeros(inputs.shape[1], np.bool_)
    batch_run(*body.runs)(p, n, s, k, np.ascontiguousarray(inputs), segments, force, held)
    return force, held
