"""Stroke and current of a recipe for `ces rig` as arrays, for the kinds that the candidate experiments use.

The diagnosis must not depend on the rig that tests it, so this is a second implementation; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.signal import max_len_seq

from ces_gap.trace import F

Rng = np.random.Generator
Recipe = Mapping[str, Any]

FINE_S = 0.5e-3  # [s] the rig's grid
DECIMATION = 2  # to 1 kHz
FADE_S = 0.5  # [s] default of strokes
CORNER_S = 0.02  # [s] default of triangles


def generate_waveforms(recipe: Recipe) -> tuple[F, F, F]:
    """Return `time_s`, `position_m` and `current_A` (n,) at 1 kHz; raises KeyError for unknown kinds."""
    time = np.arange(round(recipe["duration_s"] / FINE_S) + 1) * FINE_S
    stroke, current = recipe["stroke"], recipe["current"]
    shape = STROKES[stroke["kind"]](stroke, time, np.random.default_rng([recipe["seed"], 0]))
    position = stroke.get("offset_m", 0.0) + shape * _fade(time, stroke.get("fade_s", FADE_S))
    level = CURRENTS[current["kind"]](current, time, np.random.default_rng([recipe["seed"], 1]))
    return time[::DECIMATION], position[::DECIMATION], level[::DECIMATION]


def _rest(recipe: Recipe, time: F, rng: Rng) -> F:
    return np.zeros_like(time)


def _sine(recipe: Recipe, time: F, rng: Rng) -> F:
    return np.asarray(recipe["amplitude_m"] * np.sin(2.0 * np.pi * recipe["frequency_Hz"] * time))


def _sum_of_sines(recipe: Recipe, time: F, rng: Rng) -> F:
    total = np.zeros_like(time)
    for amplitude, frequency in zip(recipe["amplitudes_m"], recipe["frequencies_Hz"], strict=True):
        total += amplitude * np.sin(2.0 * np.pi * (frequency * time + rng.random()))
    return total


def _sweep(recipe: Recipe, time: F, rng: Rng) -> F:
    """A linear chirp whose amplitude falls as 1/frequency where the speed limit binds."""
    rise = (recipe["to_Hz"] - recipe["from_Hz"]) / time[-1]
    bound = recipe["speed_m_s"] / (2.0 * np.pi * (recipe["from_Hz"] + rise * time))
    amplitude = (recipe["amplitude_m"] ** -4 + bound**-4) ** -0.25
    return np.asarray(amplitude * np.sin(2.0 * np.pi * (recipe["from_Hz"] + rise * time / 2.0) * time))


def _triangle(recipe: Recipe, time: F, rng: Rng) -> F:
    """Constant speed to and fro, at first upwards from 0, with corners rounded by a raised-cosine window."""
    half = max(1, round(recipe.get("corner_s", CORNER_S) / FINE_S / 2.0))
    longer = np.arange(-half, len(time) + half) * FINE_S
    cycle = longer * recipe["speed_m_s"] / (4.0 * recipe["amplitude_m"])
    sharp = recipe["amplitude_m"] * (4.0 * np.abs((cycle - 0.25) % 1.0 - 0.5) - 1.0)
    window = np.sin(np.pi * np.arange(1, 2 * half + 2) / (2 * half + 2)) ** 2
    return np.convolve(sharp, window / window.sum(), mode="valid")


def _constant(recipe: Recipe, time: F, rng: Rng) -> F:
    return np.full_like(time, recipe["current_A"])


def _steps(recipe: Recipe, time: F, rng: Rng) -> F:
    held = np.floor(time / recipe["hold_s"] + 1e-9).astype(int)
    return np.asarray(np.asarray(recipe["levels_A"], dtype=np.float64)[held % len(recipe["levels_A"])])


def _prbs(recipe: Recipe, time: F, rng: Rng) -> F:
    """A maximum-length sequence of order 15 from a random start."""
    bits = max_len_seq(15)[0].astype(bool)
    held = np.floor(time / recipe["hold_s"] + 1e-9).astype(int) + int(rng.integers(len(bits)))
    return np.asarray(np.where(bits[held % len(bits)], recipe["high_A"], recipe["low_A"]), dtype=np.float64)


def _sine_current(recipe: Recipe, time: F, rng: Rng) -> F:
    middle, half = (recipe["high_A"] + recipe["low_A"]) / 2.0, (recipe["high_A"] - recipe["low_A"]) / 2.0
    return np.asarray(middle + half * np.sin(2.0 * np.pi * recipe["frequency_Hz"] * time))


def _fade(time: F, fade_s: float) -> F:
    """Return a factor that rises from 0 to 1 within `fade_s` and falls again at the end (smootherstep)."""
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
