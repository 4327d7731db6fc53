"""Withheld effects of the sensors: true signals go in, the signals of imperfect but noise-free sensors come out.

They are the same for all kinds of damper. Noise, quantisation and jitter are added later by `ces_rig.sensors`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter, lfilter_zi

from ces_data.arrays import F
from ces_rig.dampers.effects import Proportions, WithheldEffect, log_spread, signed_spread, uniform_spread
from ces_rig.dampers.stepper import spline_speed
from ces_rig.sensors import Truth

Numbers = Mapping[str, float]

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
}  # fmt: skip
GROWING = (
    "gain", "offset", "offset_N", "slope_N_s", "settling_N", "delay_s", "kick_N", "share", "rate_Ns", "amplitude_N",
    "amplitude_m",
)  # fmt: skip
"""Numbers that grow with the severity; the others set the shape."""
MAINS_HZ = 50.0


def numbers(withheld: WithheldEffect, largest_A: float) -> dict[str, float]:
    """Return the sensor's physical numbers; `largest_A` [A] is the upper end of the plant's current."""
    shape = {key: p * (withheld.severity if key in GROWING else 1.0) for key, p in withheld.proportions.items()}
    if withheld.name == "current_scale":
        shape["offset_A"] = shape.pop("offset") * largest_A
    if withheld.name == "current_crosstalk":
        shape["rate_Ns_A"] = shape.pop("rate_Ns") / largest_A
    if withheld.name == "cell_resonance":
        shape["frequency_Hz"] /= max(withheld.severity, 1e-6) ** 0.5
    return shape


def low_pass(signal: F, decay_s: float, step_s: float) -> F:
    """Return `signal` (n,) after a first-order lag that starts at rest."""
    if decay_s <= 0.0:
        return signal
    b, a = bilinear([1.0], [decay_s, 1.0], 1.0 / step_s)
    return np.asarray(lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[0])[0])


def _step(true: Truth) -> float:
    return float(true.time_s[1] - true.time_s[0])


def _add_force(true: Truth, force_N: F | float) -> Truth:
    return replace(true, force_N=true.force_N + force_N)


def _current_scale(true: Truth, p: Numbers) -> Truth:
    return replace(true, coil_A=(1.0 + p["gain"]) * true.coil_A + p["offset_A"])


def _force_drift(true: Truth, p: Numbers) -> Truth:
    since = true.time_s - true.time_s[0]
    return _add_force(true, (p["slope_N_s"] * since + p["settling_N"] * (1.0 - np.exp(-since / p["settling_s"]))))


def _force_scale(true: Truth, p: Numbers) -> Truth:
    side = 1.0 + p["asymmetry"] * np.tanh(true.force_N / 50.0)
    return _add_force(true, p["gain"] * side * true.force_N)


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
    b, a = bilinear([w * w], [1.0, 2.0 * z * w, w * w], 1.0 / _step(true))
    return replace(true, force_N=np.asarray(lfilter(b, a, true.force_N, zi=lfilter_zi(b, a) * true.force_N[0])[0]))


def _cell_creep(true: Truth, p: Numbers) -> Truth:
    return _add_force(true, p["share"] * low_pass(true.force_N, p["decay_s"], _step(true)))


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
    "current_scale": _current_scale,
    "force_offset": lambda true, p: _add_force(true, p["offset_N"]),
    "force_drift": _force_drift,
    "force_scale": _force_scale,
    "position_delay": _position_delay,
    "ring_tilt": _ring_tilt,
    "cell_resonance": _cell_resonance,
    "cell_creep": _cell_creep,
    "current_crosstalk": _crosstalk,
    "mains_hum": _mains_hum,
    "position_wave": _position_wave,
}
