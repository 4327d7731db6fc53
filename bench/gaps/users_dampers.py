"""Simulators as users write them, with named parameters: a force-speed map with a knee, Bouc-Wen, a lumped chamber.

The true damper is the same law on the true stroke, with other values and with a friction that the simulator lacks; the
simulator gets the measured stroke, whose noise it filters. No part of it is that of the virtual rig.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_data.arrays import F
from ces_data.recording import Channel, Recording

RATE_HZ = 1000.0
POSITION_NOISE_M = 3e-6


def filter_speed(time_s: F, position_m: F, corner_Hz: float = 80.0) -> F:
    """Return the speed [m/s] of a stroke behind the user's low-pass."""
    rate = 1.0 / float(np.median(np.diff(time_s)))
    sos = butter(2, corner_Hz, fs=rate, output="sos")
    return np.gradient(np.asarray(sosfiltfilt(sos, position_m)), time_s)


def knee(
    time_s: F,
    position_m: F,
    current_A: F,
    *,
    low_N_s_m: float = 1500.0,
    high_N_s_m: float = 500.0,
    knee_m_s: float = 0.12,
    gain_1_A: float = 0.8,
    gas_N_m: float = 1500.0,
    seal_N: float = 25.0,
) -> F:
    """Return the force of a damper whose curve bends at a knee, with gas and a seal."""
    speed = filter_speed(time_s, position_m)
    bent = knee_m_s * np.tanh(speed / knee_m_s)
    opened = (low_N_s_m - high_N_s_m) * bent + high_N_s_m * speed
    return np.asarray((1.0 + gain_1_A * current_A) * opened + gas_N_m * position_m + seal_N * np.tanh(speed / 0.005))


@njit(cache=True)
def _evolve(speed: F, step_s: float, gamma: float, beta: float, a: float) -> F:
    z, out = 0.0, np.zeros_like(speed)
    for k in range(len(speed)):
        v = speed[k]
        z += step_s * (a * v - gamma * abs(v) * z * abs(z) - beta * v * z * z)
        out[k] = z
    return out


def bouc_wen(
    time_s: F,
    position_m: F,
    current_A: F,
    *,
    c0_N_s_m: float = 600.0,
    c1_N_s_m_A: float = 300.0,
    alpha_N_m: float = 40000.0,
    alpha_1_A: float = 0.9,
    gamma_1_m2: float = 4e5,
    A: float = 1.0,
    k_N_m: float = 1200.0,
) -> F:
    """Return the force of a magneto-rheological damper after Bouc and Wen."""
    speed = filter_speed(time_s, position_m)
    z = _evolve(speed, float(time_s[1] - time_s[0]), gamma_1_m2, 0.25 * gamma_1_m2, A)
    yielding = alpha_N_m * (0.3 + alpha_1_A * current_A) * z
    return np.asarray((c0_N_s_m + c1_N_s_m_A * current_A) * speed + yielding + k_N_m * position_m)


@njit(cache=True)
def _fill(speed: F, current: F, step_s: float, area: float, stiffness: float, orifice: float, relief: float) -> F:
    force, out, parts = 0.0, np.zeros_like(speed), 8
    for k in range(len(speed)):
        opened = relief * (1.0 + 0.9 * current[k])
        for _ in range(parts):
            size = abs(force)
            flow = orifice * np.sqrt(size) + max(size - opened, 0.0) / area
            force += step_s / parts * stiffness * (speed[k] - np.sign(force) * flow)
        out[k] = force
    return out


def chamber(
    time_s: F,
    position_m: F,
    current_A: F,
    *,
    stiffness_N_m: float = 4e5,
    leak_N_s_m: float = 1500.0,
    orifice_1: float = 0.004,
    relief_N: float = 220.0,
    gas_N_m: float = 1500.0,
    seal_N: float = 20.0,
) -> F:
    """Return the force of one elastic chamber behind an orifice and a relief valve that the current closes."""
    speed = filter_speed(time_s, position_m)
    hydraulic = _fill(speed, current_A, float(time_s[1] - time_s[0]), leak_N_s_m, stiffness_N_m, orifice_1, relief_N)
    return np.asarray(hydraulic + gas_N_m * position_m + seal_N * np.tanh(speed / 0.005))


SIMULATORS = {"knee": knee, "bouc_wen": bouc_wen, "chamber": chamber}


def record(
    kind: str,
    values: Mapping[str, float],
    seed: int,
    seconds: float = 12.0,
    friction_N: float = 0.0,
    noise_N: float = 5.0,
    lag_s: float = 0.0,
    mass_kg: float = 0.0,
) -> Recording:
    """Return a recording of the true damper: noise strokes and steps of current, noise on force and position."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    band = butter(3, [0.3, 8.0], "bandpass", fs=RATE_HZ, output="sos")
    stroke = np.asarray(sosfiltfilt(band, rng.standard_normal(len(time))))
    stroke *= 0.008 / stroke.std()
    current = np.repeat(rng.uniform(0.0, 1.5, len(time) // 300 + 1), 300)[: len(time)]
    speed = np.gradient(stroke, time)
    force = SIMULATORS[kind](time, stroke, _lag(current, lag_s * RATE_HZ), **values)
    force = force + friction_N * np.tanh(speed / 0.008) + mass_kg * np.gradient(speed, time)
    force = force + noise_N * rng.standard_normal(len(time))
    measured = stroke + POSITION_NOISE_M * rng.standard_normal(len(time))
    stamps = np.round(time * 1e9).astype(np.int64)
    signals = {"position": ("m", measured), "current": ("A", current), "force": ("N", force)}
    channels = {name: Channel(name, unit, stamps, signal) for name, (unit, signal) in signals.items()}
    return Recording(f"{kind}_{seed}", channels)


def _lag(current: F, samples: float) -> F:
    """Return the current behind a first-order lag."""
    if samples <= 0.0:
        return current
    share = 1.0 / (samples + 1.0)
    return np.asarray(lfilter([share], [1.0, share - 1.0], current, zi=[current[0] * (1.0 - share)])[0])
