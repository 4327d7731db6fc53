"""The force some ticks ahead, predicted from the forces measured up to now.

A model of its own past force continues from the measured one (Ljung, System Identification, 2nd ed., section 3.2);
where none was measured, from its own. The others, such as hydraulic networks, know no past force: what they predict is
what they simulate, however far ahead.
"""

from __future__ import annotations

from functools import cache
from math import isfinite, nan
from typing import Any

import numpy as np

from ces_data.arrays import F, I
from ces_identify.numerics.core import compile_tick, core_kernel, pointer, with_names
from ces_identify.prepare.series import Series
from ces_observer.model import Model
from ces_observer.structures.mixture import Mixture
from ces_observer.structures.structure import OperatingRange, Structure
from ces_observer.tick.lagged import LAGGED_DEPTH, LAGGED_NEWEST, LAGGED_RINGS
from ces_observer.tick.mixture import structure_reset, structure_tick
from ces_observer.tick.model import K_STRUCTURE, KIND
from ces_observer.tick.polynomial import LAG_COUNT, OUTPUT_LAG_COUNT, OUTPUT_LAG_TABLE
from ces_observer.tick.structure import EXPERTS, FUZZY, POLYNOMIAL, SIGMOID


def predict_series(model: Model, series: Series, steps: int) -> F:
    """Return the force [N] on the ticks of a series (ticks,), each predicted `steps` ticks before.

    The first `steps` ticks of a segment are simulated; from a force that is not finite to the segment's end, all are
    NaN.
    """
    inputs = np.ascontiguousarray([series.position, series.speed, series.current])
    return _predict_body(model.body, model.operating_range, inputs, series.force, series.segments, steps)


def _predict_body(body: Structure, within: OperatingRange, inputs: F, measured: F, segments: I, steps: int) -> F:
    if isinstance(body, Mixture):
        parts = (_predict_body(m.body, m.within(within), inputs, measured, segments, steps) for m in body.members)
        mean = sum(member.weight * force for member, force in zip(body.members, parts, strict=True))
        return np.clip(mean, *within.force_N)
    arrays, force = body.lay_out(within).arrays(), np.full(len(measured), np.nan)
    state, flags = np.array(arrays.s), np.array(arrays.k, np.int64)
    given = np.array(arrays.p), np.array(arrays.n, np.int64), state, flags, state.copy(), flags.copy()
    _kernel(body.runs)(*given, inputs, measured, segments, steps, force)
    return force


@core_kernel
def feed_force(n: Any, s: Any, k: Any, force: float) -> None:
    """Put a measured force [N] in the place of the newest one of a model's own."""
    if n[KIND] == POLYNOMIAL:
        first = K_STRUCTURE + n[LAG_COUNT]
        for i in range(n[OUTPUT_LAG_COUNT]):
            row = n[OUTPUT_LAG_TABLE] + 3 * i
            newest = k[first + i] - 1
            s[newest if newest >= n[row + 1] else n[row + 2] - 1] = force
    elif n[KIND] == SIGMOID or n[KIND] == FUZZY or n[KIND] == EXPERTS:
        s[n[LAGGED_RINGS] + 3 * n[LAGGED_DEPTH] + k[LAGGED_NEWEST]] = force


def _predict(
    numbers: F, counts: I, states: F, flags: I, own: F, kept: I, inputs: F, measured: F, segments: I, steps: int, out: F
) -> None:
    """Run along the measured force in `states` and `flags`; from each tick on, run free in `own` and `kept`."""
    p, n, s, k = pointer(numbers), pointer(counts), pointer(states), pointer(flags)
    ahead_s, ahead_k = pointer(own), pointer(kept)
    for segment in range(len(segments)):
        begin, end = segments[segment, 0], segments[segment, 1]
        structure_reset(p, n, s, k)
        for i in range(begin, end):
            own[:], kept[:] = states, flags
            for j in range(i, min(i + steps, end)):
                force = structure_tick(p, n, ahead_s, ahead_k, inputs[0, j], inputs[1, j], inputs[2, j])
                if j == i + steps - 1 or i == begin:
                    out[j] = force if isfinite(force) else nan
            force = structure_tick(p, n, s, k, inputs[0, i], inputs[1, i], inputs[2, i])
            if not isfinite(force):
                out[i:end] = nan
                break
            if isfinite(measured[i]):
                feed_force(n, s, k, measured[i])


@cache
def _kernel(runs: tuple[Any, Any]) -> Any:
    """Return the kernel compiled for a structure's reset and tick."""
    reset, tick = runs
    names = {"structure_reset": compile_tick(reset), "structure_tick": compile_tick(tick)}
    return with_names(_predict, f"predict_{runs[1].__name__}", names)
