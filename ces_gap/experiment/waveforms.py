"""What a recipe for `ces rig` commands, as arrays: strokes and currents for the kinds that the menu uses.

The diagnosis may not lean on the rig that judges it, so this is written anew; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import max_len_seq

F = NDArray[np.float64]
Rng = np.random.Generator
Recipe = Mapping[str, Any]

FINE_S = 0.5e-3  # [s] the rig's own grid
DECIMATION = 2  # every second tick is kept: 1 kHz
FADE_S = 0.5  # [s] if a stroke names none
CORNER_S = 0.02  # [s] if a triangle names none


def generate_waveforms(recipe: Recipe) -> tuple[F, F, F]:
    """Return `time_s`, `position_m` and `current_A` (n,) at 1 kHz; raises KeyError for kinds it does not know."""
    time = np.arange(round(recipe["duration_s"] / FINE_S) + 1) * FINE_S
    stroke, current = recipe["stroke"], recipe["current"]
    shape = STROKES[stroke["kind"]](stroke, time, np.random.default_rng([recipe["seed"], 0]))
    position = stroke.get("offset_m", 0.0) + shape * _fade(time, stroke.get("fade_s", FADE_S))
    level = CURRENTS[current["kind"]](current, time, np.random.default_rng([recipe["seed"], 1]))
    return time[::DECIMATION], position[::DECIMATION], level[::DECIMATION]


def _rest(given: Recipe, time: F, rng: Rng) -> F:
    return np.zeros_like(time)


def _sine(given: Recipe, time: F, rng: Rng) -> F:
    return np.asarray(given["amplitude_m"] * np.sin(2.0 * np.pi * given["frequency_Hz"] * time))


def _sum_of_sines(given: Recipe, time: F, rng: Rng) -> F:
    total = np.zeros_like(time)
    for amplitude, frequency in zip(given["amplitudes_m"], given["frequencies_Hz"], strict=True):
        total += amplitude * np.sin(2.0 * np.pi * (frequency * time + rng.random()))
    return total


def _sweep(given: Recipe, time: F, rng: Rng) -> F:
    """A linear chirp whose amplitude falls as 1/frequency where the speed limit binds."""
    rise = (given["to_Hz"] - given["from_Hz"]) / time[-1]
    bound = given["speed_m_s"] / (2.0 * np.pi * (given["from_Hz"] + rise * time))
    amplitude = (given["amplitude_m"] ** -4 + bound**-4) ** -0.25
    return np.asarray(amplitude * np.sin(2.0 * np.pi * (given["from_Hz"] + rise * time / 2.0) * time))


def _triangle(given: Recipe, time: F, rng: Rng) -> F:
    """Constant speed to and fro, upwards from 0, the corners rounded by a raised-cosine window."""
    half = max(1, round(given.get("corner_s", CORNER_S) / FINE_S / 2.0))
    longer = np.arange(-half, len(time) + half) * FINE_S
    cycle = longer * given["speed_m_s"] / (4.0 * given["amplitude_m"])
    sharp = given["amplitude_m"] * (4.0 * np.abs((cycle - 0.25) % 1.0 - 0.5) - 1.0)
    window = np.sin(np.pi * np.arange(1, 2 * half + 2) / (2 * half + 2)) ** 2
    return np.convolve(sharp, window / window.sum(), mode="valid")


def _constant(given: Recipe, time: F, rng: Rng) -> F:
    return np.full_like(time, given["current_A"])


def _steps(given: Recipe, time: F, rng: Rng) -> F:
    held = np.floor(time / given["hold_s"] + 1e-9).astype(int)
    return np.asarray(np.asarray(given["levels_A"], dtype=np.float64)[held % len(given["levels_A"])])


def _prbs(given: Recipe, time: F, rng: Rng) -> F:
    """A maximum-length sequence of order 15 from a drawn start."""
    bits = max_len_seq(15)[0].astype(bool)
    held = np.floor(time / given["hold_s"] + 1e-9).astype(int) + int(rng.integers(len(bits)))
    return np.asarray(np.where(bits[held % len(bits)], given["high_A"], given["low_A"]), dtype=np.float64)


def _sine_current(given: Recipe, time: F, rng: Rng) -> F:
    middle, half = (given["high_A"] + given["low_A"]) / 2.0, (given["high_A"] - given["low_A"]) / 2.0
    return np.asarray(middle + half * np.sin(2.0 * np.pi * given["frequency_Hz"] * time))


def _fade(time: F, fade_s: float) -> F:
    """Return a factor that rises from 0 to 1 within `fade_s` and falls back at the end (smootherstep)."""
    if fade_s == 0.0:
        return np.ones_like(time)
    u = np.clip(np.minimum(time, time[-1] - time) / fade_s, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 + u * (6.0 * u - 15.0)))


STROKES: Mapping[str, Callable[[Recipe, F, Rng], F]] = {
    "rest": _rest,
    "sine": _sine,
    "sum_of_sines": _sum_of_sines,
    "sweep": _sweep,
    "triangle": _triangle,
}
CURRENTS: Mapping[str, Callable[[Recipe, F, Rng], F]] = {
    "constant": _constant,
    "steps": _steps,
    "prbs": _prbs,
    "sine": _sine_current,
}
