"""What moves a live damper, endlessly: a scripted loop, set points, or a quarter vehicle on an ISO 8608 road.

A script is a loop of position and speed on the rig's grid, with a smooth transition on changes. The road is white noise
behind a first-order filter in distance, so that speed and class may change: its spectral density is G(n) =
G(n0)·n0²/(n² + nc²), the standard's with waviness 2 above `nc` (1/100 m); the tyre averages waves shorter than its
contact patch by a second first-order filter in distance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, isfinite, pi, sqrt

import numpy as np
from numba import njit
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from ces_data.arrays import F, I
from ces_data.waveforms.strokes import (
    REAR,
    Common,
    NoiseStroke,
    Rest,
    Shape,
    Sine,
    Stroke,
    Sweep,
    Triangle,
    smooth_step,
)
from ces_observer.records import choice, quantity
from ces_rig.dampers.stepper import spline_speed
from ces_rig.errors import RigError
from ces_rig.sensors import make_rng

BLOCK = 200  # grid points computed at once; a changed script waits for the next block
BLEND_S = 0.5  # [s] from one script to the next
CYCLES_S = 5.0  # [s] shortest loop of whole cycles: rounds the frequency by 5e-5 at most
PERIODIC = ("sine", "triangle")


@dataclass(frozen=True)
class Script:
    """The stroke that the actuator repeats."""

    kind: str = choice("sine", "kind of stroke", ("rest", "sine", "sweep", "noise", "triangle"))
    amplitude_m: float = quantity(0.015, "m", "largest distance from mid-stroke", 0.0, 0.5)
    frequency_Hz: float = quantity(2.0, "Hz", "frequency of sine and triangle", 0.05, 50.0)
    from_Hz: float = quantity(1.0, "Hz", "sweep: frequency at the start", 0.05, 100.0)
    to_Hz: float = quantity(12.0, "Hz", "sweep: frequency at the end", 0.05, 100.0)
    speed_m_s: float = quantity(0.45, "m/s", "sweep: limit of the peak speed", 1e-3, 10.0)
    cutoff_Hz: float = quantity(15.0, "Hz", "noise: cutoff of the low-pass filter", 0.1, 50.0)
    loop_s: float = quantity(30.0, "s", "sweep and noise: length of the loop", 2.0, 600.0)


@dataclass(frozen=True)
class Loop:
    """A stroke [m] and its speed [m/s] on grid points, each (n,); point n is point 0 again."""

    stroke_m: F
    speed_m_s: F

    def require_within(self, reach_m: float) -> Loop:
        """Return the loop; raises RigError if it leaves ±`reach_m`."""
        reach = float(np.abs(self.stroke_m).max())
        if reach > reach_m:
            raise RigError(f"rig: the stroke reaches {reach:.4g} m; the damper's ends are at ±{reach_m:g} m")
        return self


def make_loop(script: Script, interval_s: float, seed: int) -> Loop:
    """Return the script's loop; raises RigError."""
    if script.kind in PERIODIC and script.amplitude_m > 0.0:
        return _make_cycles(script, interval_s)
    time = _times(round(script.loop_s / interval_s), interval_s)
    stroke = Stroke(_shape(script), Common()).samples(time, make_rng(seed, "stroke"))
    return Loop(stroke[:-1], spline_speed(time, stroke)[:-1])


class Actuator:
    """Moves through a loop at grid points every `interval_s` seconds, and blends into another loop on request."""

    def __init__(self, loop: Loop, interval_s: float) -> None:
        self._loop, self._place = loop, 0
        self._new: Loop | None = None
        self._requested: Loop | None = None
        points = round(BLEND_S / interval_s / BLOCK) * BLOCK or BLOCK
        u = np.arange(1, points + 1) / points
        self._weight = smooth_step(u)
        self._weight_rate = 30.0 * (u * (1.0 - u)) ** 2 / (points * interval_s)
        self._blended = 0
        self._ready = np.empty((2, 0))
        self._next = 0

    def change(self, loop: Loop) -> None:
        """Change to another loop, within half a second, as soon as the last change is complete."""
        self._requested = loop

    def moves(self, count: int) -> tuple[F, F]:
        """Return the next `count` strokes [m] and speeds [m/s], at most BLOCK."""
        if self._next + count > self._ready.shape[1]:
            self._ready = np.concatenate([self._ready[:, self._next :], self._block()], axis=1)
            self._next = 0
        self._next += count
        part = slice(self._next - count, self._next)
        return self._ready[0, part], self._ready[1, part]

    def _block(self) -> F:
        if self._new is None and self._requested is not None:
            self._new, self._requested, self._blended = self._requested, None, 0
        at = np.arange(self._place + 1, self._place + BLOCK + 1)
        self._place += BLOCK
        old = _points(self._loop, at)
        if self._new is None:
            return old
        new, part = _points(self._new, at), slice(self._blended, self._blended + BLOCK)
        weight, rate = self._weight[part], self._weight_rate[part]
        mixed = old + weight * (new - old)
        mixed[1] += rate * (new[0] - old[0])
        self._blended += BLOCK
        if self._blended == len(self._weight):
            self._loop, self._new = self._new, None
        return mixed


def _points(loop: Loop, at: I) -> F:
    place = at % len(loop.stroke_m)
    return np.stack([loop.stroke_m[place], loop.speed_m_s[place]])


def _times(points: int, interval_s: float) -> F:
    return np.arange(points + 1, dtype=np.float64) * interval_s


def _make_cycles(script: Script, interval_s: float) -> Loop:
    """Return whole cycles with a periodic spline, so that the seam needs no fade."""
    cycles = max(1, round(CYCLES_S * script.frequency_Hz))
    points = round(cycles / script.frequency_Hz / interval_s)
    time = _times(points, interval_s)
    exact = replace(script, frequency_Hz=cycles / (points * interval_s))
    stroke = _shape(exact).samples(time, np.random.default_rng(0))
    stroke[-1] = stroke[0]
    speed = CubicSpline(time, stroke, bc_type="periodic")(time, 1)
    return Loop(stroke[:-1], np.asarray(speed[:-1]))


def _shape(script: Script) -> Shape:
    a, f = script.amplitude_m, script.frequency_Hz
    shapes: dict[str, Shape] = {
        "sine": Sine(a, f),
        "sweep": Sweep(script.from_Hz, script.to_Hz, a, script.speed_m_s),
        "noise": NoiseStroke(2.0 * a, script.cutoff_Hz),
        "triangle": Triangle(a, 4.0 * a * f, min(0.02, 0.1 / f)),
    }
    return shapes.get(script.kind, Rest()) if a > 0.0 else Rest()


class Follower:
    """Follows the newest set point at grid points every `interval_s`; a set point that is not finite is refused."""

    def __init__(self, bandwidth_Hz: float, reach_m: float, interval_s: float) -> None:
        self._omega, self._reach_m, self._interval_s = 2.0 * pi * bandwidth_Hz, reach_m, interval_s
        self._decay = exp(-self._omega * interval_s)
        self._wanted_m = self._stroke_m = self._speed_m_s = 0.0

    def set_stroke(self, stroke_m: float) -> None:
        """Accept a set point, limited to the reach."""
        if isfinite(stroke_m):
            self._wanted_m = min(max(stroke_m, -self._reach_m), self._reach_m)

    def moves(self, count: int) -> tuple[F, F]:
        """Return the next `count` strokes [m] and speeds [m/s].

        Between set points the distance e obeys e'' + 2 w e' + w² e = 0, solved exactly: no overshoot, any interval.
        """
        out, w, h = np.empty((2, count)), self._omega, self._interval_s
        for k in range(count):
            distance = self._stroke_m - self._wanted_m
            slope = self._speed_m_s + w * distance
            self._stroke_m = self._wanted_m + (distance + slope * h) * self._decay
            self._speed_m_s = (slope - w * (distance + slope * h)) * self._decay
            out[:, k] = self._stroke_m, self._speed_m_s
        return out[0], out[1]


CLASSES = ("A", "B", "C", "D", "E", "F", "G", "H")
CLASS_A_M3 = 16e-6  # [m³] G(n0) of class A by ISO 8608; each further class has four times as much
REFERENCE_1_M = 0.1  # n0 [cycles/m]
MAX_WAVE_M = 100.0  # [m] waves longer than this fade out
CONTACT_M = 0.1  # [m] length of the tyre's contact patch
ROAD_BLOCK = 100  # grid points computed at once; a new speed or class waits for the next block
AVERAGING = 2.8  # contact length over the length of a first-order filter with 3 dB attenuation at the same wave


class LiveRoad:
    """The road under the wheel at grid points every `interval_s` seconds; `road_class` and `speed_m_s` may be set."""

    def __init__(self, road_class: str, speed_m_s: float, interval_s: float, rng: Generator) -> None:
        self.road_class, self.speed_m_s = road_class, speed_m_s
        self._interval_s, self._rng = interval_s, rng
        self._state = np.zeros(2)  # profile and height under the tyre [m]
        self._block, self._next = np.empty(0), 0

    def heights(self, count: int) -> F:
        """Return the next `count` heights [m] under the tyre, at most ROAD_BLOCK."""
        if self._next + count > len(self._block):
            new = self._rng.standard_normal(ROAD_BLOCK)
            roughness = CLASS_A_M3 * 4.0 ** CLASSES.index(self.road_class)
            roll(self._state, roughness, self.speed_m_s * self._interval_s, new)
            self._block, self._next = np.concatenate([self._block[self._next :], new]), 0
        self._next += count
        return self._block[self._next - count : self._next]


@njit(cache=True)
def roll(state: F, roughness: float, distance: float, out: F) -> None:
    """Convert normal random numbers in `out` to heights [m] under the tyre, `distance` [m] apart."""
    corner = 1.0 / MAX_WAVE_M
    decay = exp(-2.0 * pi * corner * distance)
    spread = sqrt(0.5 * pi * roughness * REFERENCE_1_M**2 / corner * (1.0 - decay * decay))
    left = exp(-AVERAGING * distance / CONTACT_M)
    for k in range(out.shape[0]):
        state[0] = decay * state[0] + spread * out[k]
        state[1] = state[0] + left * (state[1] - state[0])
        out[k] = state[1]


METAL_M = 1e-3  # [m] distance of the metal stops from the damper's end


@dataclass(frozen=True)
class Vehicle:
    """A quarter vehicle at the damper's own lever ratio, and its road."""

    sprung_kg: float = quantity(REAR.sprung_kg, "kg", "mass of the body on this wheel", 10.0, 5e3)
    unsprung_kg: float = quantity(REAR.unsprung_kg, "kg", "mass of wheel, tyre and parts moving with them", 1.0, 500.0)
    spring_N_m: float = quantity(REAR.spring_N_m, "N/m", "main spring", 100.0, 1e6)
    tyre_N_m: float = quantity(REAR.tyre_N_m, "N/m", "tyre, vertical stiffness", 1e3, 1e7)
    tyre_Ns_m: float = quantity(REAR.tyre_damping_Ns_m, "N·s/m", "tyre, vertical damping", 0.0, 1e5)
    stop_clearance_m: float = quantity(0.040, "m", "stroke, either way, where the bump stop begins", 1e-3, 0.5)
    stop_N_m: float = quantity(6e4, "N/m", "bump stop stiffness at first contact", 0.0, 1e7)
    stop_m: float = quantity(8e-3, "m", "deflection that doubles the bump stop's secant stiffness", 1e-4, 0.1)
    road_class: str = choice("C", "ISO 8608 road class", CLASSES)
    speed_m_s: float = quantity(16.7, "m/s", "driving speed", 0.0, 80.0)

    def numbers(self, reach_m: float) -> F:
        """Return `VehicleNumbers` (VEHICLE_SIZE,) for ends at ±`reach_m`; raises RigError if the stop begins beyond."""
        limit = reach_m - METAL_M
        if self.stop_clearance_m >= limit:
            raise RigError(f"vehicle: stop_clearance_m {self.stop_clearance_m:g} is not below the stroke {limit:g} m")
        chassis = (self.sprung_kg, self.unsprung_kg, self.spring_N_m, self.tyre_N_m, self.tyre_Ns_m)
        return np.array([*chassis, self.stop_clearance_m, self.stop_N_m, self.stop_m, limit])
