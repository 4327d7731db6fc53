"""The plant's own elasticity, learnt from the simulated force.

A plant with memory (compressible oil, presliding friction) is not a static map of speed and current. A better model is
such a map in series with a spring (Maxwell element): F = f(v - c·dF/dt).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.derivative import derivative
from ces_gap.plant_map.map_kernels import forward_backward, pole_of
from ces_gap.plant_map.speed_map import SpeedMap, learn_map

F = NDArray[np.float64]
B = NDArray[np.bool_]

CORNER_HZ = 100.0  # [Hz] above it a simulated force is mostly noise
COMPLIANCES = (0.0, *(1.0 / np.geomspace(3e5, 3e7, 9)))  # [m/N] rigid, then from soft to stiff
SOFT = 0.03  # of the RMS of force and speed: width of the change from one compliance to the other


@dataclass(frozen=True)
class SprungMap:
    """A map of speed and current behind a spring of `compliance` c [m/N]; `rest` [N] is the force at standstill."""

    map: SpeedMap
    compliance: float
    rest: float


@dataclass(frozen=True)
class PumpedMap:
    """A map behind a spring with two compliances `own` [m/N]: while the damper is pushed and moves in, and otherwise.

    `widths` [N], [m/s] smooth the change between them. `memory` [N] (n,) is the plant's force minus that of this model.
    """

    map: SpeedMap
    own: tuple[float, float]
    widths: tuple[float, float]
    memory: F


def remove_high_frequencies(force: F, rate_Hz: float) -> F:
    """Return the force (n,) behind a low-pass at `CORNER_HZ` without delay."""
    corner = min(CORNER_HZ, 0.25 * rate_Hz)
    return np.asarray(forward_backward(np.ascontiguousarray(force), pole_of(corner, rate_Hz)))


def learn_sprung_map(speed: F, current: F, force: F, usable: B, rate_Hz: float) -> SprungMap:
    """Return the map and spring that fit the simulated `force` [N] best on the usable ticks.

    `speed` [m/s] and `current` [A] are the inputs of the simulation; all arrays are (n,).
    """
    rate, used = derivative(remove_high_frequencies(force, rate_Hz), rate_Hz), _usable_or_all(usable)
    best, least, compliant = learn_map(speed, current, force, usable), np.inf, 0.0
    for compliance in COMPLIANCES:
        through = speed - compliance * rate
        trial = learn_map(through, current, force, usable)
        residual = (force - trial.force(through, current))[used]
        if float(residual @ residual) < least:
            best, least, compliant = trial, float(residual @ residual), compliance
    return SprungMap(best, compliant, best.rest(current))


def learn_pumped_map(speed: F, current: F, force: F, usable: B, rate_Hz: float, equal: float) -> PumpedMap:
    """Return the map and the two compliances that fit the simulated force [N] best, searched in turn.

    Both start at `equal` [m/N], the compliance of `learn_sprung_map`; the other arguments are the same as there.
    """
    smooth, used = remove_high_frequencies(force, rate_Hz), _usable_or_all(usable)
    widths = (SOFT * _rms(smooth[used]) + 1e-3, SOFT * _rms(speed[used]) + 1e-6)
    pumping = 0.25 * (1.0 + np.tanh(smooth / widths[0])) * (1.0 + np.tanh(speed / widths[1]))
    rate = derivative(smooth, rate_Hz)

    def fit(own: tuple[float, float]) -> tuple[float, SpeedMap, F]:
        through = speed - (own[1] + pumping * (own[0] - own[1])) * rate
        best = learn_map(through, current, force, usable)
        residual = force - best.force(through, current)
        return float(residual[used] @ residual[used]), best, residual

    own = (equal, equal)
    for _ in range(2):
        own = min(((c, own[1]) for c in COMPLIANCES), key=lambda o: fit(o)[0])
        own = min(((own[0], c) for c in COMPLIANCES), key=lambda o: fit(o)[0])
    _, best, residual = fit(own)
    return PumpedMap(best, own, widths, remove_high_frequencies(residual, rate_Hz))


def _usable_or_all(usable: B) -> B:
    return usable if usable.any() else np.ones(len(usable), bool)


def _rms(values: F) -> float:
    return float(np.sqrt(np.mean(values**2)))
