"""The plant's own elasticity: what its force lags behind its speed by, learnt from the simulation itself.

A plant with memory (oil that is squeezed, friction that holds before it slides) is not a map of speed and current; it
is nearer to such a map in series with a spring of its own (Maxwell): F = f(v - c·dF/dt).
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.series_kernels import forward_backward, pole_of
from ces_gap.effects.speed_map import SpeedMap, learn_map
from ces_gap.trace import Inputs, Trace, derivative

F = NDArray[np.float64]

CORNER_HZ = 100.0  # [Hz] above it a simulated force is noise rather than motion
COMPLIANCES = (0.0, *(1.0 / np.geomspace(3e5, 3e7, 9)))  # [m/N] none, then from soft to stiff
SOFT = 0.03  # of the RMS of force and speed: width of the change from one compliance to the other
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


@dataclass(frozen=True)
class PumpedMap:
    """A map behind a spring of one compliance [m/N] while pushed and moving in, another otherwise (`own`).

    `memory` [N] (n,) is what the plant's force is more than that.
    """

    map: SpeedMap
    own: tuple[float, float]
    widths: tuple[float, float]
    memory: F


_pumped: OrderedDict[tuple[int, int], tuple[PumpedMap, F, Inputs]] = OrderedDict()


def learn_pumped(trace: Trace) -> PumpedMap:
    """Return the map and the two compliances that explain the simulated force [N] best, each searched in turn."""
    key = (id(trace.simulated), id(trace.inputs))
    if key not in _pumped:
        _pumped[key] = (_search_pumped(trace), trace.simulated, trace.inputs)
        while len(_pumped) > KEPT:
            _pumped.popitem(last=False)
    return _pumped[key][0]


def _search_pumped(trace: Trace) -> PumpedMap:
    inputs, force = trace.inputs, banded(trace.simulated, trace.rate_Hz)
    used = trace.usable if trace.usable.any() else np.ones(len(trace), bool)
    widths = (SOFT * _rms(force[used]) + 1e-3, SOFT * _rms(inputs.speed[used]) + 1e-6)
    pumping = 0.25 * (1.0 + np.tanh(force / widths[0])) * (1.0 + np.tanh(inputs.speed / widths[1]))
    rate = derivative(force, trace.rate_Hz)

    def left(own: tuple[float, float]) -> tuple[float, SpeedMap, F]:
        speed = inputs.speed - (own[1] + pumping * (own[0] - own[1])) * rate
        found = learn_map(trace, Inputs(inputs.position, speed, inputs.current), trace.simulated)
        residual = trace.simulated - found.force(speed, inputs.current)
        return float(residual[used] @ residual[used]), found, residual

    alike = learn_sprung(trace).compliance
    own = (alike, alike)
    for _ in range(2):
        own = min(((c, own[1]) for c in COMPLIANCES), key=lambda o: left(o)[0])
        own = min(((own[0], c) for c in COMPLIANCES), key=lambda o: left(o)[0])
    _, found, residual = left(own)
    return PumpedMap(found, own, widths, banded(residual, trace.rate_Hz))


def _rms(values: F) -> float:
    return float(np.sqrt(np.mean(values**2)))
