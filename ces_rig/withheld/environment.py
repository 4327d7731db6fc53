"""Withheld effects outside the damper: of the sensors, of what drives its valve, and of the frame that holds it.

They are the same for all kinds of damper. Imperfect sensors turn true signals into what noise-free sensors read; noise,
quantisation and jitter are added later by `ces_rig.sensors`. In its surroundings the damper's equations stay, but the
current in its valve is not the logged one, or its stroke is not, because the frame gives way and rings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter, lfilter_zi

from ces_data.arrays import F
from ces_rig.dampers.model import Proportions, RigDamper, WithheldEffect, log_spread, signed_spread, uniform_spread
from ces_rig.dampers.stepper import DamperStepper, simulate, spline_speed
from ces_rig.errors import RigError
from ces_rig.sensors import Truth

Numbers = Mapping[str, float]

SURROUNDINGS = ("sticking_pilot", "current_ripple", "frame_resonance")  # the others are effects of the sensors
SPREADS: Mapping[str, Proportions] = {
    "current_scale": {"gain": signed_spread(0.02, 0.1), "offset": signed_spread(0.002, 0.03)},
    "force_offset": {"offset_N": signed_spread(30.0, 60.0)},
    "force_drift": {
        "slope_N_s": signed_spread(2.0, 6.0), "settling_N": uniform_spread(-20.0, 20.0),
        "settling_s": log_spread(2.0, 8.0),
    },
    "force_scale": {"gain": signed_spread(0.02, 0.08), "asymmetry": uniform_spread(-0.15, 0.15)},
    "position_delay": {"delay_s": signed_spread(1e-3, 4e-3), "lag_share": uniform_spread(0.0, 0.6)},
    "ring_tilt": {
        "kick_N": log_spread(40.0, 90.0), "decay_s": log_spread(0.01, 0.04), "turn_m_s": log_spread(0.01, 0.03),
    },
    "cell_resonance": {"frequency_Hz": log_spread(45.0, 75.0), "damping": log_spread(0.03, 0.1)},
    "cell_creep": {"share": signed_spread(0.05, 0.12), "decay_s": log_spread(0.15, 1.5)},
    "current_crosstalk": {"rate_Ns": signed_spread(2.0, 6.0), "decay_s": log_spread(2e-3, 1e-2)},
    "mains_hum": {"amplitude_N": log_spread(20.0, 60.0), "phase_rad": uniform_spread(0.0, 6.28),
                  "third": uniform_spread(0.0, 0.4)},
    "position_wave": {
        "amplitude_m": log_spread(1e-4, 3e-4), "pitch_m": log_spread(4e-3, 1.2e-2),
        "phase_rad": uniform_spread(0.0, 6.28),
    },
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
GROWING = (
    "gain", "offset", "offset_N", "slope_N_s", "settling_N", "delay_s", "kick_N", "share", "rate_Ns", "amplitude_N",
    "amplitude_m", "threshold", "amplitude", "compliance_m_N",
)  # fmt: skip
"""Numbers that grow with the severity; the others set the shape."""
OF_CURRENT = {"current_scale": "offset", "sticking_pilot": "threshold", "current_ripple": "amplitude"}
"""Numbers that are shares of the largest current."""
MAINS_HZ = 50.0
MIN_FRAME_KG = 5.0  # a lighter frame would need a finer grid


def numbers(withheld: WithheldEffect, largest_A: float) -> dict[str, float]:
    """Return the physical numbers of an effect; `largest_A` [A] is the upper end of the plant's current."""
    shape = {key: p * (withheld.severity if key in GROWING else 1.0) for key, p in withheld.proportions.items()}
    if key := OF_CURRENT.get(withheld.name):
        shape[f"{key}_A"] = shape.pop(key) * largest_A
    if withheld.name == "current_crosstalk":
        shape["rate_Ns_A"] = shape.pop("rate_Ns") / largest_A
    if withheld.name == "cell_resonance":
        shape["frequency_Hz"] /= max(withheld.severity, 1e-6) ** 0.5
    return shape


def low_pass(signal: F, decay_s: float, step_s: float) -> F:
    """Return `signal` (n,) after a first-order lag that starts at rest."""
    return _filter(signal, [1.0], [decay_s, 1.0], step_s) if decay_s > 0.0 else signal


def _filter(signal: F, numerator: list[float], denominator: list[float], step_s: float) -> F:
    """Return `signal` (n,) after a continuous filter (coefficients of falling powers of s) that starts at rest."""
    b, a = bilinear(numerator, denominator, 1.0 / step_s)
    return np.asarray(lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[0])[0])


def _step(true: Truth) -> float:
    return float(true.time_s[1] - true.time_s[0])


def _add_force(true: Truth, force_N: F | float) -> Truth:
    return replace(true, force_N=true.force_N + force_N)


def _force_drift(true: Truth, p: Numbers) -> Truth:
    since = true.time_s - true.time_s[0]
    return _add_force(true, (p["slope_N_s"] * since + p["settling_N"] * (1.0 - np.exp(-since / p["settling_s"]))))


def _position_delay(true: Truth, p: Numbers) -> Truth:
    """A late position is partly delayed, partly lagged by the sensor's filter; an early one is only shifted."""
    delay = p["delay_s"]
    lag = max(0.0, delay) * p["lag_share"]
    at = np.clip(true.time_s - (delay - lag), true.time_s[0], true.time_s[-1])
    shifted = np.asarray(CubicSpline(true.time_s, true.stroke_m)(at))
    return replace(true, stroke_m=low_pass(shifted, lag, _step(true)))


def _ring_tilt(true: Truth, p: Numbers) -> Truth:
    """After each reversal a tilted ring scrapes, less and less until it lies flat."""
    direction = np.tanh(spline_speed(true.time_s, true.stroke_m) / p["turn_m_s"])
    return _add_force(true, p["kick_N"] * (direction - low_pass(direction, p["decay_s"], _step(true))))


def _cell_resonance(true: Truth, p: Numbers) -> Truth:
    """The fixture's mass rings on the load cell's spring."""
    w, z = 2.0 * np.pi * p["frequency_Hz"], p["damping"]
    return replace(true, force_N=_filter(true.force_N, [w * w], [1.0, 2.0 * z * w, w * w], _step(true)))


def _crosstalk(true: Truth, p: Numbers) -> Truth:
    """The coil's changing current induces a voltage in the load cell's leads."""
    rate = np.gradient(true.coil_A, true.time_s)
    return _add_force(true, p["rate_Ns_A"] * low_pass(rate, p["decay_s"], _step(true)))


def _mains_hum(true: Truth, p: Numbers) -> Truth:
    angle = 2.0 * np.pi * MAINS_HZ * true.time_s + p["phase_rad"]
    return _add_force(true, p["amplitude_N"] * (np.sin(angle) + p["third"] * np.sin(3.0 * angle)))


def _position_wave(true: Truth, p: Numbers) -> Truth:
    wave = np.sin(2.0 * np.pi * true.stroke_m / p["pitch_m"] + p["phase_rad"]) - np.sin(p["phase_rad"])
    return replace(true, stroke_m=true.stroke_m + p["amplitude_m"] * wave)


SENSING: Mapping[str, Callable[[Truth, Numbers], Truth]] = {
    "current_scale": lambda true, p: replace(true, coil_A=(1.0 + p["gain"]) * true.coil_A + p["offset_A"]),
    "force_offset": lambda true, p: _add_force(true, p["offset_N"]),
    "force_drift": _force_drift,
    "force_scale": lambda true, p: _add_force(
        true, p["gain"] * (1.0 + p["asymmetry"] * np.tanh(true.force_N / 50.0)) * true.force_N
    ),
    "position_delay": _position_delay,
    "ring_tilt": _ring_tilt,
    "cell_resonance": _cell_resonance,
    "cell_creep": lambda true, p: _add_force(true, p["share"] * low_pass(true.force_N, p["decay_s"], _step(true))),
    "current_crosstalk": _crosstalk,
    "mains_hum": _mains_hum,
    "position_wave": _position_wave,
}


def run_surrounded(
    model: RigDamper, effects: Mapping[str, Numbers], interval_s: float, stroke_m: F, command_A: F
) -> tuple[F, F, F]:
    """Run the damper inside its surroundings; `effects` are physical numbers by name.

    Arrays (n,). Returns force [N], logged coil current [A] and temperature [°C]. Raises RigError.
    """
    run = simulate(model, interval_s, stroke_m, command_A)
    coil = acting = run.coil_A
    if p := effects.get("current_ripple"):
        wave = np.sin(2.0 * np.pi * p["frequency_Hz"] * run.time_s + p["phase_rad"])
        acting = np.maximum(acting + p["amplitude_A"] * wave, 0.0)
    if p := effects.get("sticking_pilot"):
        acting = hold_until_free(acting, p["threshold_A"])
    bare = model.without_coil()
    if p := effects.get("frame_resonance"):
        force, temperature = _run_on_frame(bare, p, interval_s, stroke_m, acting)
        return force, coil, temperature
    if acting is not coil:
        run = simulate(bare, interval_s, stroke_m, acting)
    return run.tared_N, coil, run.temperature_degC


def hold_until_free(signal: F, threshold: float) -> F:
    """Return `signal` (n,) behind stiction: stuck after a reversal or stop until `threshold` away, then free."""
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


def _run_on_frame(model: RigDamper, p: Numbers, interval_s: float, stroke_m: F, current_A: F) -> tuple[F, F]:
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
    stepper, force, frame = DamperStepper(model, interval_s), np.empty(count), np.zeros(2)
    states = np.empty((count, len(stepper.state)))
    force[0] = stepper.settle(logged[0, 0], logged[1, 0], current_A[0]) - stepper.rest_N
    states[0] = stepper.state
    for n in range(1, count):
        middle = 1.5 * force[n - 1] - 0.5 * force[max(n - 2, 0)] - force[0]
        frame = free @ frame + pushed * middle
        one = slice(n, n + 1)
        left = logged[:, one] - frame[:, np.newaxis]
        force[one] = stepper.advance(left[0], left[1], current_A[one], states[one]) - stepper.rest_N
    return force, np.asarray(states[:, stepper.kind.kernel.TEMPERATURE])


def _discretise_frame(p: Numbers, interval_s: float) -> tuple[F, F]:
    """Return A (2, 2) and b (2,) of the step of deflection [m] and speed [m/s] under a constant force [N]."""
    w, z = 2.0 * np.pi * p["frequency_Hz"], p["damping"]
    wd, decay = w * (1.0 - z * z) ** 0.5, np.exp(-z * w * interval_s)
    c, s = np.cos(wd * interval_s), np.sin(wd * interval_s) / wd
    free = decay * np.array([[c + z * w * s, s], [-w * w * s, c - z * w * s]])
    return free, p["compliance_m_N"] * (np.array([1.0, 0.0]) - free[:, 0])
