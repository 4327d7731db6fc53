"""The plant's own elasticity: what its force lags behind its speed by, learnt from the simulation itself.

A plant with memory (oil that is squeezed, friction that holds before it slides) is not a map of speed and current; it
is nearer to such a map in series with a spring of its own (Maxwell): F = f(v - c·dF/dt).
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.series_kernels import forward_backward, pole_of
from ces_gap.speed_map import SpeedMap, learn_map
from ces_gap.trace import Inputs, Trace, derivative

F = NDArray[np.float64]

CORNER_HZ = 100.0  # [Hz] above it a simulated force is noise rather than motion
COMPLIANCES = (0.0, *(1.0 / np.geomspace(3e5, 3e7, 9)))  # [m/N] none, then from soft to stiff
KEPT = 16  # of the last learnt: a fit asks for the same ones again and again


@dataclass(frozen=True)
class SprungMap:
    """A map of speed and current behind a spring of `compliance` c [m/N]; `rest` [N] is the force at standstill."""

    map: SpeedMap
    compliance: float
    rest: float


_learnt: OrderedDict[tuple[int, int], tuple[SprungMap, F, Inputs]] = OrderedDict()


def learn_sprung(trace: Trace) -> SprungMap:
    """Return the map and the spring that explain the simulated force [N] best over the usable ticks."""
    key = (id(trace.simulated), id(trace.inputs))  # kept with the answer, so that nothing else can have their ids
    if key not in _learnt:
        _learnt[key] = (_search(trace, trace.inputs, trace.simulated), trace.simulated, trace.inputs)
        while len(_learnt) > KEPT:
            _learnt.popitem(last=False)
    return _learnt[key][0]


def banded(force: F, rate_Hz: float) -> F:
    """Return the force (n,) without what is above `CORNER_HZ`, not delayed."""
    corner = min(CORNER_HZ, 0.25 * rate_Hz)
    return np.asarray(forward_backward(np.ascontiguousarray(force), pole_of(corner, rate_Hz)))


def _search(trace: Trace, inputs: Inputs, force: F) -> SprungMap:
    rate = derivative(banded(force, trace.rate_Hz), trace.rate_Hz)
    used = trace.usable if trace.usable.any() else np.ones(len(trace), bool)
    best, least, compliant = learn_map(trace, inputs, force), np.inf, 0.0
    for compliance in COMPLIANCES:
        through = Inputs(inputs.position, inputs.speed - compliance * rate, inputs.current)
        found = learn_map(trace, through, force)
        left = (force - found.force(through.speed, through.current))[used]
        if float(left @ left) < least:
            best, least, compliant = found, float(left @ left), compliance
    return SprungMap(best, compliant, best.rest(inputs.current))
