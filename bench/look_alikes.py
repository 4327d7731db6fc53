"""Sound recordings in which something looks like a delay: inertia, slow valves, gas springs, position dependence.

Their equations are their own: damping that saturates over the speed, a valve with a lag of the first order, Coulomb
friction, a gas column, a mass between piston and load cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.random import Generator
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_data.arrays import F
from ces_data.recording import Channel, Recording

GRID_S, MAX_SPEED_M_S, MAX_MASS_KG = 2.5e-4, 2.0, 100.0
KINDS = ("inertia", "slow valve", "gas spring", "position-sensitive", "all of them")
STROKES = ("sweep", "noise", "steps", "moves")
CURRENTS = ("constant", "stepped", "sine")


def draw_look_alikes(seed: int) -> Iterator[Recording]:
    """Yield 60 recordings, one for each kind, stroke and current."""
    yield from (make_look_alike(*words, seed) for words in product(KINDS, STROKES, CURRENTS))


def make_look_alike(kind: str, stroke: str, current: str, seed: int) -> Recording:
    """Return a recording of a damper of KINDS, on a stroke of STROKES at a current of CURRENTS."""
    rng = np.random.default_rng([seed, KINDS.index(kind), STROKES.index(stroke), CURRENTS.index(current)])
    time: F = np.arange(round(rng.uniform(12.0, 25.0) / GRID_S)) * GRID_S
    x = rng.uniform(0.01, 0.06) * _stroke(stroke, time, rng)
    x *= min(1.0, MAX_SPEED_M_S / float(np.abs(np.gradient(x, GRID_S)).max()))
    v = np.gradient(x, GRID_S)
    everything = kind == KINDS[-1]
    command = _current(current, time, rng)
    lag_s = rng.uniform(0.02, 0.12) if kind == "slow valve" or everything else rng.uniform(0.002, 0.012)
    opening = 0.3 + _lag(command, lag_s)
    knee = rng.uniform(0.03, 0.4)
    force = rng.uniform(500.0, 4000.0) * knee * opening * np.tanh(v / knee) + rng.uniform(100.0, 2000.0) * v
    force *= np.where(v > 0.0, rng.uniform(0.4, 1.0), 1.0)
    share = x / np.abs(x).max()
    if kind == "position-sensitive" or everything:
        narrow = 1.0 - rng.uniform(0.3, 0.8) * np.exp(-((share / rng.uniform(0.2, 0.5)) ** 4))
        force *= narrow if rng.random() < 0.5 else 1.0 + rng.uniform(0.5, 3.0) * share**2
    force = _lag(force, rng.uniform(0.0005, 0.006)) + rng.uniform(10.0, 100.0) * np.tanh(v / 0.005)
    reach = float(np.abs(force).max())
    if kind == "gas spring" or everything:
        length = rng.uniform(1.5, 4.0)
        force += rng.uniform(0.05, 0.8) * reach * (length / (length - share)) ** 1.3
    if kind == "inertia" or everything:
        acceleration = sosfiltfilt(butter(2, 200.0, fs=1.0 / GRID_S, output="sos"), np.gradient(v, GRID_S))
        ratio = reach / float(np.percentile(np.abs(acceleration), 99.0))
        force += min(rng.uniform(0.1, 1.0) * ratio, MAX_MASS_KG) * acceleration
    kept = slice(None, None, int(rng.choice([2, 4, 8])))
    noises = (10.0 ** rng.uniform(-5.7, -4.7), 1e-3, reach * 10.0 ** rng.uniform(-3.3, -2.0))
    stamps = np.rint(time[kept] * 1e9).astype(np.int64)
    signals = zip((("position", "m"), ("current", "A"), ("force", "N")), (x, command, force), noises, strict=True)
    channels = {n: Channel(n, u, stamps, s[kept] + rng.normal(0.0, e, len(stamps))) for (n, u), s, e in signals}
    return Recording(f"{kind} {stroke} {current}", channels)


def _lag(signal: F, seconds: float) -> F:
    keep = seconds / (seconds + GRID_S)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], signal, zi=[keep * signal[0]])[0])


def _stroke(name: str, time: F, rng: Generator) -> F:
    """Return a stroke (n,) of up to 1."""
    if name == "sweep":
        rise = rng.uniform(6.0, 15.0) / time[-1]
        return np.asarray(
            np.minimum(1.0, 1.0 / (0.3 + rise * time)) * np.sin(2 * np.pi * (0.3 + 0.5 * rise * time) * time)
        )
    if name == "steps":  # of a sine's amplitude
        grown = sosfiltfilt(butter(2, 2.0, fs=1.0 / GRID_S, output="sos"), np.floor(time / time[-1] * 3.999) + 1.0)
        return np.asarray(0.25 * grown * np.sin(2.0 * np.pi * rng.uniform(1.0, 4.0) * time))
    if name == "noise":
        band = butter(2, [0.3, rng.uniform(4.0, 12.0)], "band", fs=1.0 / GRID_S, output="sos")
        stroke = sosfiltfilt(band, rng.normal(size=len(time)))
        return np.asarray(stroke / np.abs(stroke).max())
    ends = np.cumsum(rng.uniform(0.2, 0.7, 140))  # of point-to-point moves, each with a rest
    targets, at = rng.uniform(-1.0, 1.0, 141), np.searchsorted(ends, time)
    begin = np.concatenate([[0.0], ends])
    share = np.minimum(1.0, (time - begin[at]) / (rng.uniform(0.6, 0.9) * np.diff(begin)[at]))
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.asarray(targets[at] + (targets[at + 1] - targets[at]) * smooth)


def _current(name: str, time: F, rng: Generator) -> F:
    if name == "constant":
        return np.full(len(time), rng.uniform(0.2, 1.2))
    if name == "sine":
        return np.asarray(0.8 + 0.6 * np.sin(2.0 * np.pi * rng.uniform(0.2, 5.0) * time))
    return np.asarray(rng.uniform(0.0, 1.6, 100)[(time / rng.uniform(0.3, 1.5)).astype(np.int64)])
