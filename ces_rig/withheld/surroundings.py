"""Withheld effects between the sensors and the damper: what drives its valve, and the frame that holds it.

They are outside the library and the same for all kinds of damper: the damper's equations stay, but the current in its
valve is not the logged one, or its stroke is not the logged one because the frame gives way and rings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from ces_rig.dampers.effects import Proportions, WithheldEffect, log_spread, uniform_spread
from ces_rig.dampers.hydraulic.stepper import spline_speed
from ces_rig.dampers.kinds import KINDS, DamperModel
from ces_rig.errors import RigError

Array = NDArray[np.float64]
Numbers = Mapping[str, float]
Run = tuple[Array, Array, Array]
"""Force [N], logged coil current [A] and temperature [°C], each (n,)."""

SPREADS: Mapping[str, Proportions] = {
    "sticking_pilot": {"threshold": log_spread(0.03, 0.12)},
    "current_ripple": {
        "amplitude": log_spread(0.02, 0.08), "frequency_Hz": log_spread(25.0, 120.0),
        "phase_rad": uniform_spread(0.0, 6.28),
    },
    "frame_resonance": {
        "compliance_m_N": log_spread(2e-8, 2e-7), "frequency_Hz": log_spread(20.0, 60.0),
        "damping": log_spread(0.02, 0.06),
    },
}  # fmt: skip
MIN_FRAME_KG = 5.0  # a lighter frame would need a finer grid


def numbers(withheld: WithheldEffect, largest_A: float) -> dict[str, float]:
    """Return the physical numbers; `largest_A` [A] is the upper end of the plant's current."""
    p, s = withheld.proportions, withheld.severity
    if withheld.name == "frame_resonance":
        return {**p, "compliance_m_N": s * p["compliance_m_N"]}
    size = "threshold" if withheld.name == "sticking_pilot" else "amplitude"
    return {**{key: value for key, value in p.items() if key != size}, f"{size}_A": s * p[size] * largest_A}


def run_surrounded(
    kind: str, model: DamperModel, effects: Mapping[str, Numbers], interval_s: float, stroke_m: Array, command_A: Array
) -> Run:
    """Run the damper inside its surroundings; `effects` are physical numbers by name. Arrays (n,). Raises RigError."""
    force, coil, temperature = model.run(interval_s, stroke_m, command_A)
    acting = coil
    for name, change in ACTING_CURRENT.items():
        if name in effects:
            acting = change(np.arange(len(coil), dtype=np.float64) * interval_s, acting, effects[name])
    bare = model.without_coil()
    if "frame_resonance" in effects:
        force, temperature = _run_on_frame(kind, bare, effects["frame_resonance"], interval_s, stroke_m, acting)
    elif acting is not coil:
        force, _, temperature = bare.run(interval_s, stroke_m, acting)
    return force, coil, temperature


def hold_until_free(signal: Array, threshold: float) -> Array:
    """Return `signal` (n,) behind stiction: stuck after a reversal or a stop, until it is `threshold` away.

    Once free, it follows at once; sliding friction is neglected.
    """
    held = np.empty_like(signal)
    level, direction, before = signal[0], 0.0, signal[0]
    for n, value in enumerate(signal):
        if direction == 0.0 and abs(value - level) > threshold:
            direction = np.sign(value - level)
        elif direction * (value - before) <= 0.0:
            direction = 0.0
        level = value if direction != 0.0 else level
        held[n], before = level, value
    return held


def _ripple(time_s: Array, current_A: Array, p: Numbers) -> Array:
    wave = np.sin(2.0 * np.pi * p["frequency_Hz"] * time_s + p["phase_rad"])
    return np.maximum(current_A + p["amplitude_A"] * wave, 0.0)


ACTING_CURRENT: Mapping[str, Callable[[Array, Array, Numbers], Array]] = {
    "current_ripple": _ripple,
    "sticking_pilot": lambda _time, current, p: hold_until_free(current, p["threshold_A"]),
}


def _run_on_frame(
    kind: str, model: DamperModel, p: Numbers, interval_s: float, stroke_m: Array, current_A: Array
) -> tuple[Array, Array]:
    """Return force and temperature of a damper whose frame, a mass on a lightly damped spring, yields to its force.

    The logged stroke is between actuator and ground. Step by step: the frame moves under the force at the middle of
    the step (extrapolated, so that the exchange is of second order), then the damper under what is left of the stroke.
    """
    mass = 1.0 / (p["compliance_m_N"] * (2.0 * np.pi * p["frequency_Hz"]) ** 2)
    if mass < MIN_FRAME_KG:
        raise RigError(f"{kind} plant: frame_resonance: mass is {mass:.3g} kg; expected at least {MIN_FRAME_KG:g} kg")
    free, pushed = _discretise_frame(p, interval_s)
    damper, count = KINDS[kind], len(stroke_m)
    time = np.arange(count, dtype=np.float64) * interval_s
    late = np.interp(time - model.delay_s, time, current_A)
    logged = np.stack([stroke_m, spline_speed(time, stroke_m), current_A, late])
    moves, one, values = np.ascontiguousarray(logged[:, :2]), np.empty(1), model.coefficients()
    force, temperature, frame = np.empty(count), np.empty(count), np.zeros(2)
    state, force[0] = model.settle(*logged[:3, 0])
    temperature[0] = state[damper.temperature]
    substeps = max(1, round(interval_s / damper.step_s))
    for n in range(1, count):
        moves[:, 0] = moves[:, 1] if n > 1 else logged[:, 0]
        middle = 1.5 * force[n - 1] - 0.5 * force[max(n - 2, 0)] - force[0]
        frame = free @ frame + pushed * middle
        moves[:, 1] = logged[:, n]
        moves[:2, 1] -= frame
        damper.drive(values, state, moves, interval_s, substeps, one)
        force[n], temperature[n] = one[0], state[damper.temperature]
    return force, temperature


def _discretise_frame(p: Numbers, interval_s: float) -> tuple[Array, Array]:
    """Return A (2, 2) and b (2,) of the step of deflection [m] and speed [m/s] under a constant force [N]."""
    w, z = 2.0 * np.pi * p["frequency_Hz"], p["damping"]
    wd, decay = w * (1.0 - z * z) ** 0.5, np.exp(-z * w * interval_s)
    c, s = np.cos(wd * interval_s), np.sin(wd * interval_s) / wd
    free = decay * np.array([[c + z * w * s, s], [-w * w * s, c - z * w * s]])
    return free, p["compliance_m_N"] * (np.array([1.0, 0.0]) - free[:, 0])
