"""Withheld effects between the sensors and the damper: what drives its valve, and the frame that holds it.

They are outside the library and the same for all kinds of damper: the damper's equations stay, but the current in its
valve is not the logged one, or its stroke is not the logged one because the frame gives way and rings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ces_data.arrays import F
from ces_rig.dampers.effects import Proportions, WithheldEffect, log_spread, uniform_spread
from ces_rig.dampers.model import DamperModel
from ces_rig.dampers.stepper import DamperStepper, simulate, spline_speed
from ces_rig.errors import RigError

Numbers = Mapping[str, float]
Run = tuple[F, F, F]
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
    model: DamperModel, effects: Mapping[str, Numbers], interval_s: float, stroke_m: F, command_A: F
) -> Run:
    """Run the damper inside its surroundings; `effects` are physical numbers by name. Arrays (n,). Raises RigError."""
    run = simulate(model, interval_s, stroke_m, command_A)
    coil = acting = run.coil_A
    for name, change in ACTING_CURRENT.items():
        if name in effects:
            acting = change(run.time_s, acting, effects[name])
    bare = model.without_coil()
    if "frame_resonance" in effects:
        force, temperature = _run_on_frame(bare, effects["frame_resonance"], interval_s, stroke_m, acting)
        return force, coil, temperature
    if acting is not coil:
        run = simulate(bare, interval_s, stroke_m, acting)
    return run.tared_N, coil, run.temperature_degC


def hold_until_free(signal: F, threshold: float) -> F:
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


def _ripple(time_s: F, current_A: F, p: Numbers) -> F:
    wave = np.sin(2.0 * np.pi * p["frequency_Hz"] * time_s + p["phase_rad"])
    return np.maximum(current_A + p["amplitude_A"] * wave, 0.0)


ACTING_CURRENT: Mapping[str, Callable[[F, F, Numbers], F]] = {
    "current_ripple": _ripple,
    "sticking_pilot": lambda _time, current, p: hold_until_free(current, p["threshold_A"]),
}


def _run_on_frame(model: DamperModel, p: Numbers, interval_s: float, stroke_m: F, current_A: F) -> tuple[F, F]:
    """Return force and temperature of a damper whose frame, a mass on a lightly damped spring, yields to its force.

    The logged stroke is between actuator and ground. Step by step: the frame moves under the force at the middle of
    the step (extrapolated, so that the exchange is of second order), then the damper under what is left of the stroke.
    """
    mass, count = 1.0 / (p["compliance_m_N"] * (2.0 * np.pi * p["frequency_Hz"]) ** 2), len(stroke_m)
    if mass < MIN_FRAME_KG:
        where = f"{model.kind} plant: frame_resonance"
        raise RigError(f"{where}: mass is {mass:.3g} kg; expected at least {MIN_FRAME_KG:g} kg")
    free, pushed = _discretise_frame(p, interval_s)
    time = np.arange(count, dtype=np.float64) * interval_s
    logged = np.stack([stroke_m, spline_speed(time, stroke_m)])
    late = np.interp(time - model.delay_s, time, current_A)
    stepper, force, frame = DamperStepper(model, interval_s), np.empty(count), np.zeros(2)
    states = np.empty((count, len(stepper.state)))
    force[0] = stepper.settle(logged[0, 0], logged[1, 0], current_A[0]) - stepper.rest_N
    states[0] = stepper.state
    for n in range(1, count):
        middle = 1.5 * force[n - 1] - 0.5 * force[max(n - 2, 0)] - force[0]
        frame = free @ frame + pushed * middle
        one = slice(n, n + 1)
        left = logged[:, one] - frame[:, np.newaxis]
        force[one] = stepper.advance(left[0], left[1], current_A[one], late[one], states[one]) - stepper.rest_N
    return force, np.asarray(states[:, stepper.kind.kernel.TEMPERATURE])


def _discretise_frame(p: Numbers, interval_s: float) -> tuple[F, F]:
    """Return A (2, 2) and b (2,) of the step of deflection [m] and speed [m/s] under a constant force [N]."""
    w, z = 2.0 * np.pi * p["frequency_Hz"], p["damping"]
    wd, decay = w * (1.0 - z * z) ** 0.5, np.exp(-z * w * interval_s)
    c, s = np.cos(wd * interval_s), np.sin(wd * interval_s) / wd
    free = decay * np.array([[c + z * w * s, s], [-w * w * s, c - z * w * s]])
    return free, p["compliance_m_N"] * (np.array([1.0, 0.0]) - free[:, 0])
