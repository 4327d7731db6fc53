"""An analytic damper with planted effects, written as textbooks have them, on a grid finer than a recording's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from made_recordings import recording_of

from ces_data.arrays import F
from ces_gap.trace import Trace, make_trace

FINE_HZ, LOGGED_HZ = 10000, 1000
NOISE_N = 8.0
SECONDS = 12.0


@dataclass(frozen=True)
class Motion:
    """Time [s], position [m], speed [m/s], acceleration [m/s2] and the damper's own force [N], each (n,)."""

    time: F
    position: F
    speed: F
    acceleration: F
    force: F

    @property
    def step(self) -> float:
        """Seconds from sample to sample."""
        return 1.0 / FINE_HZ


Planted = Callable[[Motion], F]  # the force [N] (n,) with an effect


@lru_cache(maxsize=8)
def motion(seconds: float = SECONDS) -> Motion:
    """Return strokes of 0.4 to 6 Hz with exact derivatives, and a degressive damper's force."""
    rng = np.random.default_rng(3)
    time = np.arange(round(seconds * FINE_HZ)) / FINE_HZ
    x, v, a = np.zeros_like(time), np.zeros_like(time), np.zeros_like(time)
    for frequency in np.geomspace(0.4, 6.0, 7):
        omega, phase = 2.0 * np.pi * frequency, rng.uniform(0.0, 2.0 * np.pi)
        size = 0.009 / frequency**0.7
        x += size * np.sin(omega * time + phase)
        v += size * omega * np.cos(omega * time + phase)
        a -= size * omega**2 * np.sin(omega * time + phase)
    force = np.where(v > 0.0, 900.0, 1700.0) * np.tanh(v / 0.15) + 500.0 * v
    return Motion(time, x, v, a, force)


def trace(planted: Planted | None = None, temperature: F | None = None, seconds: float = SECONDS) -> Trace:
    """Return the trace of a recording with the planted effect; its simulation is the damper without."""
    true = motion(seconds)
    rng = np.random.default_rng(7)
    logged = slice(None, None, FINE_HZ // LOGGED_HZ)
    time = true.time[logged]
    measured = true.force if planted is None else planted(true)
    signals = {"position": true.position[logged], "force": measured[logged] + NOISE_N * rng.standard_normal(len(time))}
    if temperature is not None:
        signals["temperature"] = temperature[logged]
    return make_trace(replace(recording_of(time, **signals), constants={"current": 0.5}), true.force[logged])


def coulomb_stribeck(coulomb: float, rounding: float, excess: float, stribeck: float) -> Planted:
    def force(m: Motion) -> F:
        size = coulomb * (1.0 + excess * np.exp(-((m.speed / stribeck) ** 2)))
        return m.force + size * np.tanh(m.speed / rounding)

    return force


def lugre(coulomb: float, presliding: float, excess: float = 0.0, viscous: float = 0.0) -> Planted:
    """The differential equation itself, by Euler's method on the fine grid: sigma0 = coulomb / presliding."""

    def force(m: Motion) -> F:
        level = 1.0 + excess * np.exp(-((m.speed / 0.02) ** 2))
        bend = np.zeros_like(m.time)  # [m]
        for k in range(1, len(bend)):
            v, limit = m.speed[k], presliding * level[k]
            bend[k] = bend[k - 1] + m.step * (v - abs(v) / limit * bend[k - 1])
        return m.force + coulomb / presliding * bend + coulomb * viscous * m.speed

    return force


def mass(kilograms: float) -> Planted:
    return lambda m: m.force + kilograms * m.acceleration


def gas(pressure: float, area: float, volume: float, tare: float = 0.0) -> Planted:
    """p V^1.3 constant, the cell tared at `tare` [m]; pressure [Pa] and volume [m3] are those there."""

    def force(m: Motion) -> F:
        compressed = volume - area * (m.position - tare)
        return m.force + area * pressure * ((volume / compressed) ** 1.3 - 1.0)

    return force


def faded(per_joule: float, cooling: float = np.inf) -> Planted:
    def force(m: Motion) -> F:
        heat, power = np.zeros_like(m.time), m.force * m.speed
        for k in range(1, len(heat)):
            heat[k] = heat[k - 1] + m.step * (power[k] - heat[k - 1] / cooling)
        return m.force * np.exp(-per_joule * heat)

    return force


def stopped(stiffness: float, hardening: float, compression: float, rebound: float) -> Planted:
    """Sharp contacts."""

    def force(m: Motion) -> F:
        pushed = np.maximum(m.position - compression, 0.0)
        pulled = np.maximum(rebound - m.position, 0.0)
        return m.force + stiffness * (pushed - pulled) + hardening * (pushed**2 - pulled**2)

    return force


def drifted(settled: float, settling: float) -> Planted:
    return lambda m: m.force + settled * (1.0 - np.exp(-m.time / settling))
