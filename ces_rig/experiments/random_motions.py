"""Candidates: random strokes of several kinds, each scaled into a rig's limits, and random currents.

The kinds complement each other. Multisines with random phases and coloured amplitudes spread over stroke and speed like
roads (Schroeder 1970; Pintelon and Schoukens, System Identification, 2012, ch. 5). Sines of wandering frequency and
amplitude stay near the edge of the speed range. Strokes of constant speed between random turning points are an
amplitude-modulated random sequence of the speed (Nelles, Nonlinear System Identification, 2001, ch. 17): they dwell at
slow speeds, which the others cross quickly.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np
from numpy.random import Generator

from ces_data.arrays import F
from ces_data.waveforms.strokes import filtered_noise
from ces_rig.experiments.commands import INTERVAL_S, RigLimits

MIN_HZ = 0.3
SINES = 24
LEVELS = (0.06, 0.92)  # range of a motion's peak, as a share of the limits; the rest is for the transitions
FULL_SHARE = 0.5  # of the motions that use the range up to its end


def draw_motion(limits: RigLimits, count: int, rng: Generator) -> F:
    """Return a random stroke (count,) [m] around 0 that keeps the limits of stroke, speed and acceleration."""
    shape = MOTIONS[int(rng.integers(len(MOTIONS)))](limits, count, rng)
    low, high = LEVELS
    level = high if rng.random() < FULL_SHARE else float(np.exp(rng.uniform(np.log(low), np.log(high))))
    stroke = shape * level / peak_share(shape, limits)
    room = high * limits.stroke_m - float(np.abs(stroke).max())
    return np.asarray(stroke + max(0.0, room) * rng.uniform(-1.0, 1.0) * (rng.random() < 0.5))


def peak_share(stroke: F, limits: RigLimits) -> float:
    """Return the largest share of the limits that a stroke (n,) around 0 uses; above 1 it leaves them."""
    speed = np.diff(stroke) / INTERVAL_S
    acceleration = np.diff(speed) / INTERVAL_S
    shares = (
        np.abs(stroke).max() / limits.stroke_m,
        np.abs(speed).max() / limits.speed_m_s,
        np.abs(acceleration).max() / limits.acceleration_m_s2,
    )
    return max(1e-12, *map(float, shares))


def _multisine(limits: RigLimits, count: int, rng: Generator) -> F:
    low, high = _band(limits, rng)
    frequency = np.geomspace(low, high, SINES) * np.exp(rng.uniform(-0.05, 0.05, SINES))
    amplitude = frequency ** -rng.uniform(0.5, 2.0)
    time = np.arange(count) * INTERVAL_S
    angles = 2.0 * pi * (np.minimum(frequency, limits.frequency_Hz)[:, None] * time + rng.random((SINES, 1)))
    stroke = amplitude @ np.sin(angles)
    return np.asarray(stroke - 0.5 * (stroke.max() + stroke.min()))


def _wandering_sine(limits: RigLimits, count: int, rng: Generator) -> F:
    low, high = _band(limits, rng)
    wander = _smooth_walk(count, 0.8, rng)
    frequency = np.exp(np.log(low) + (np.log(high) - np.log(low)) * (0.5 + 0.5 * wander))
    amplitude = frequency ** -rng.uniform(0.3, 1.3) * (1.0 + 0.6 * _smooth_walk(count, 1.2, rng))
    return np.asarray(amplitude * np.sin(2.0 * pi * (np.cumsum(frequency) * INTERVAL_S + rng.random())))


def _constant_speeds(limits: RigLimits, count: int, rng: Generator) -> F:
    """Return straight strokes between turning points on alternating sides, each at its own speed, corners rounded."""
    top = float(np.exp(rng.uniform(np.log(0.08), 0.0))) * limits.speed_m_s
    reach = float(rng.uniform(0.2, 1.0)) * limits.stroke_m
    window = np.hanning(round(1.0 / limits.frequency_Hz / INTERVAL_S) + 2)[1:-1]  # one period rounds the corners
    points, times, side = [0.0], [0.0], 1.0
    while times[-1] < (count + len(window)) * INTERVAL_S:
        points.append(side * reach * float(rng.uniform(0.1, 1.0)))
        speed = top * float(np.exp(rng.uniform(np.log(0.15), 0.0)))
        times.append(times[-1] + max(abs(points[-1] - points[-2]) / speed, 0.5 / limits.frequency_Hz))
        side = -side
    line = np.interp(np.arange(count + len(window) - 1) * INTERVAL_S, times, points)
    return np.convolve(line, window / window.sum(), mode="valid")


def _band(limits: RigLimits, rng: Generator) -> tuple[float, float]:
    """Return a random band [Hz] within what the actuator follows, at least half an octave wide."""
    edges = np.exp(rng.uniform(np.log(MIN_HZ), np.log(limits.frequency_Hz), 2))
    low, high = float(edges.min()), float(edges.max())
    return min(low, high / 1.5), high


def _smooth_walk(count: int, highest_Hz: float, rng: Generator) -> F:
    """Return a slow random signal (count,) between -1 and 1."""
    time, frequency = np.arange(count) * INTERVAL_S, rng.uniform(0.1, highest_Hz, 4)
    walk = np.sin(2.0 * pi * (frequency[:, None] * time + rng.random((4, 1)))).sum(axis=0)
    return np.asarray(walk / np.abs(walk).max())


MOTIONS: tuple[Callable[[RigLimits, int, Generator], F], ...] = (_multisine, _wandering_sine, _constant_speeds)


MAX_HOLD_S = 1.0
SETTLE_S = 1.0  # of the filter before a noise


def draw_current(limits: RigLimits, count: int, rng: Generator) -> F:
    """Return a random current (count,) [A] within the limits."""
    kind = CURRENTS[int(rng.choice(len(CURRENTS), p=WEIGHTS))]
    share = np.clip(kind(limits, count, rng), 0.0, 1.0)
    return np.asarray(limits.low_A + (limits.high_A - limits.low_A) * share)


def _held_levels(limits: RigLimits, count: int, rng: Generator) -> F:
    """Return levels held for log-uniform times; stratified, so that any few of them cover the range."""
    longest = float(np.exp(rng.uniform(np.log(2.0 * limits.hold_s), np.log(max(MAX_HOLD_S, 3.0 * limits.hold_s)))))
    holds = np.exp(rng.uniform(np.log(limits.hold_s), np.log(longest), int(count * INTERVAL_S / limits.hold_s) + 2))
    strata = np.concatenate([rng.permutation(5) for _ in range(len(holds) // 5 + 1)])[: len(holds)]
    levels = (strata + rng.random(len(holds))) / 5.0
    levels = np.round(levels) if rng.random() < 0.25 else levels
    return np.asarray(levels[np.searchsorted(np.cumsum(holds), np.arange(count) * INTERVAL_S, side="right")])


def _noise(limits: RigLimits, count: int, rng: Generator) -> F:
    cutoff = float(np.exp(rng.uniform(np.log(0.7), np.log(8.0))))
    noise = filtered_noise(count, 1.0 / INTERVAL_S, 2, cutoff, SETTLE_S, rng)
    return np.asarray(0.5 + 0.5 * np.tanh(rng.uniform(0.6, 1.5) * noise / noise.std() + rng.uniform(-0.3, 0.3)))


def _sine(limits: RigLimits, count: int, rng: Generator) -> F:
    frequency = float(np.exp(rng.uniform(np.log(0.3), np.log(8.0))))
    middle = float(rng.uniform(0.3, 0.7))
    angle = 2.0 * pi * (frequency * np.arange(count) * INTERVAL_S + rng.random())
    return np.asarray(middle + min(middle, 1.0 - middle) * np.sin(angle))


CURRENTS: tuple[Callable[[RigLimits, int, Generator], F], ...] = (
    _held_levels, _noise, _sine, lambda _limits, count, rng: np.full(count, float(rng.random())),
)  # fmt: skip
WEIGHTS = (0.5, 0.25, 0.15, 0.1)
