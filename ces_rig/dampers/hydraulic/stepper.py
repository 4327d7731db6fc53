"""Runs the hydraulic damper: strokes and currents go in, forces come out, all at once or in chunks.

The stroke comes with its speed, because between samples it is the cubic through both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.hydraulic.coefficients import coefficients
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.errors import RigError

Array = NDArray[np.float64]
NO_EXTRAS: Mapping[str, float] = MappingProxyType({})
NO_STATES = np.empty((0, hy.STATE_SIZE))
STEP_S = 50e-6  # integration step: halving it changes the force by less than 0.2 % (test_hydraulics)


@dataclass(frozen=True)
class SimulatedRun:
    """A simulated run: `time_s`, `force_N` of shape (n,) and `states` of shape (n, len(kernel.STATE_NAMES))."""

    time_s: Array
    force_N: Array
    states: Array

    def state(self, name: str) -> Array:
        """Return one state over time, by its name in `kernel.STATE_NAMES`."""
        return self.states[:, hy.STATE_NAMES.index(name)]


class Stepper:
    """The damper with a state that persists between chunks; chunks give exactly the forces of one batch.

    `extras` are coefficients of the kernel that have no parameter (see `kernel.Coefficients`).
    """

    def __init__(
        self, damper: Damper, interval_s: float, step_s: float = STEP_S, extras: Mapping[str, float] = NO_EXTRAS
    ) -> None:
        if not interval_s > 0.0 or not step_s > 0.0:
            raise RigError(f"interval {interval_s!r} s and step {step_s!r} s; expected numbers above 0")
        self.damper, self.interval_s = damper, interval_s
        self.substeps = max(1, round(interval_s / step_s))
        self.coefficients = coefficients(damper)._replace(**extras)
        self.state = np.zeros(hy.STATE_SIZE)
        self.reset()

    def reset(self, stroke_m: float = 0.0, speed_m_s: float = 0.0, current_A: float = 0.0) -> float:
        """Bring the damper to rest at this input and return its force [N]."""
        self.state[:] = equilibrium(self.damper, stroke_m, speed_m_s, current_A)
        return float(hy.mount_force(self.coefficients, self.state, stroke_m, speed_m_s)[0])

    def advance(
        self, stroke_m: ArrayLike, speed_m_s: ArrayLike, current_A: ArrayLike, states: Array = NO_STATES
    ) -> Array:
        """Return the force [N] (n,) at the next n inputs, one every `interval_s`; fills `states` (n, STATE_SIZE)."""
        x, v, i = (np.ascontiguousarray(a, dtype=np.float64) for a in (stroke_m, speed_m_s, current_A))
        force = np.empty(len(x))
        hy.advance(self.coefficients, self.state, x, v, i, self.interval_s, self.substeps, force, states)
        return force


def simulate(
    damper: Damper, interval_s: float, stroke_m: Array, current_A: Array, speed_m_s: Array | None = None,
    step_s: float = STEP_S, extras: Mapping[str, float] = NO_EXTRAS,
) -> SimulatedRun:  # fmt: skip
    """Drive `damper` from rest with samples every `interval_s` seconds; all arrays of shape (n,), n at least 2.

    Without `speed_m_s` the speed is that of the cubic spline through the stroke. Force is positive in compression and
    includes the gas force. Raises RigError for unequal lengths and for values not finite or beyond the damper's ends.
    """
    stroke, current = np.asarray(stroke_m, dtype=np.float64), np.asarray(current_A, dtype=np.float64)
    check_input(damper, stroke, current)
    time = np.arange(len(stroke), dtype=np.float64) * interval_s
    speed = spline_speed(time, stroke) if speed_m_s is None else np.asarray(speed_m_s, dtype=np.float64)
    stepper = Stepper(damper, interval_s, step_s, extras)
    force, states = np.empty(len(stroke)), np.empty((len(stroke), hy.STATE_SIZE))
    force[0] = stepper.reset(stroke[0], speed[0], current[0])
    states[0] = stepper.state
    force[1:] = stepper.advance(stroke[1:], speed[1:], current[1:], states[1:])
    return SimulatedRun(time, force, states)


def spline_speed(time_s: Array, stroke_m: Array) -> Array:
    """Return the derivative [m/s] of the cubic spline through `stroke_m`."""
    return np.asarray(CubicSpline(time_s, stroke_m)(time_s, 1), dtype=np.float64)


def equilibrium(damper: Damper, stroke_m: float, speed_m_s: float, current_A: float) -> Array:
    """Return the kernel's state at rest at this stroke: equal pressure everywhere, filled at mid-stroke."""
    c = coefficients(damper)
    fill = hy.oil_mass(c, 0.0, c.gas_pressure, c.gas_pressure, c.gas_pressure)

    def excess(p: float) -> float:
        return float(hy.oil_mass(c, stroke_m, p, p, p) - fill)

    p = float(brentq(excess, 0.05 * c.gas_pressure, 50.0 * c.gas_pressure, xtol=1e-3))
    state = np.zeros(hy.STATE_SIZE)
    held = c.rod_area * (p - hy.ATMOSPHERE_PA)
    state[hy.PISTON] = stroke_m - held / c.mount - np.copysign(0.5 * c.play, held)
    state[hy.SPEED] = speed_m_s
    state[hy.P_COMPRESSION : hy.P_GAS + 1] = p
    state[hy.TEMPERATURE] = damper.heat.start_degC
    state[hy.COIL] = state[hy.LAST_CURRENT] = current_A
    state[hy.PLAY : hy.PLAY + hy.PLAYS] = current_A
    state[hy.PILOT] = hy.cracking_drop(c, current_A)
    state[hy.LAST_STROKE], state[hy.LAST_SPEED] = stroke_m, speed_m_s
    return state


def rest_force(damper: Damper) -> float:
    """Return the gas force [N] on the rod at mid-stroke, which the rig's tare subtracts."""
    return damper.rod_area_m2 * (damper.reservoir.pressure_Pa - hy.ATMOSPHERE_PA)


def check_input(damper: Damper, stroke: Array, current: Array) -> None:
    """Raise RigError for unequal lengths, for values that are not finite or a stroke beyond the damper's ends."""
    if stroke.ndim != 1 or stroke.shape != current.shape or len(stroke) < 2:
        raise RigError(f"rig: {stroke.shape} strokes and {current.shape} currents; expected equal lengths, at least 2")
    if not (np.isfinite(stroke).all() and np.isfinite(current).all()):
        raise RigError("rig: a stroke or current is not finite; clean the input first")
    reach, limit = np.abs(stroke).max(), damper.body.half_stroke_m
    if reach > limit:
        raise RigError(f"rig: the stroke reaches {reach:.4g} m; the damper's ends are at ±{limit:g} m from mid-stroke")
