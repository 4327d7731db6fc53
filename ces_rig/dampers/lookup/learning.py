"""Learns a damper known by a table from a recording: a static map of speed and current, and two lags, go out.

The force is fitted by least squares with hat functions of speed and current, for a few lags of the valve and
stiffnesses of the series spring; the pair that leaves the least wins. What the recording never visits is filled in
smoothly.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_rig.dampers.lookup.parameters import LEVELS, MIN_SLOPE, SPEEDS, Lookup
from ces_rig.errors import RigError

STEP_S = 1e-3
SMOOTHING_HZ = 40.0
LAGS_S = (1e-3, 2e-3, 4e-3, 7e-3, 12e-3, 20e-3)
STIFFNESSES_N_m = (5e5, 1e6, 2e6, 4e6, 8e6, 2e7)
SMOOTHNESS = 0.02  # weight of the differences between neighbours in the table
MIN_CURRENTS_A = 0.05  # range
MIN_EXPLAINED = 0.7  # share of the force's variance
ZERO = SPEEDS.index(0.0)


def learn_lookup(recording: Recording) -> Lookup:
    """Return the damper; raises RigError if the force of the recording does not follow its speed and current."""
    speed, force, current = _read_signals(recording)
    low, high = (float(value) for value in np.percentile(current, [1.0, 99.0]))
    if high - low < MIN_CURRENTS_A:
        raise RigError(f"{recording.name}: currents from {low:.3g} to {high:.3g} A; expected several, to learn a map")
    largest = float(np.percentile(np.abs(speed), 99.5))
    rate, best = np.gradient(force, STEP_S), (np.inf, 0.0, 0.0, np.zeros(0))
    for lag, stiffness in product(LAGS_S, STIFFNESSES_N_m):
        kept = float(np.exp(-STEP_S / lag))
        acting = lfilter([1.0 - kept], [1.0, -kept], current, zi=[kept * current[0]])[0]
        share = (acting - low) / (high - low) * (LEVELS - 1)
        table, left = _fit_table((speed - rate / stiffness) / largest, share, force)
        best = min(best, (left, lag, stiffness, table), key=lambda one: one[0])
    left, lag, stiffness, table = best
    if left > 1.0 - MIN_EXPLAINED:
        raise RigError(
            f"{recording.name}: speed and current explain {max(1.0 - left, 0.0):.0%} of its force; expected at least "
            f"{MIN_EXPLAINED:.0%}; check signs and delays"
        )
    rising = _rise(table, largest)
    return replace(
        Lookup(), low_A=max(low, 0.0), high_A=high, speed_m_s=largest, rise_s=lag, fall_s=lag, oil_N_m=stiffness,
        table=tuple(rising.ravel().tolist()),
    )  # fmt: skip


def _read_signals(recording: Recording) -> tuple[F, F, F]:
    """Return speed [m/s], force [N] and current [A] (n,) on a uniform grid, the first two without fast parts."""
    channels = [recording.channel(name) for name in ("position", "force", "current")]
    start, end = (int(f(c.stamps_ns[i] for c in channels)) for f, i in ((max, 0), (min, -1)))
    grid = np.arange(start, end, round(1e9 * STEP_S))
    position, force, current = (np.interp(grid, c.stamps_ns, c.values) for c in channels)
    sos = butter(2, SMOOTHING_HZ, fs=1.0 / STEP_S, output="sos")
    return np.gradient(sosfiltfilt(sos, position), STEP_S), sosfiltfilt(sos, force), current


def _fit_table(speed: F, level: F, force: F) -> tuple[F, float]:
    """Return the table [N] (LEVELS, speeds) without a constant force, and the share of the variance that it leaves."""
    hats = [_hats(speed, np.array(SPEEDS)), _hats(level, np.arange(LEVELS, dtype=np.float64))]
    design = np.einsum("nl,ns->nls", hats[1], np.delete(hats[0], ZERO, axis=1)).reshape(len(force), -1)
    design = np.column_stack([design, np.ones(len(force))])
    steps = np.eye(LEVELS * (len(SPEEDS) - 1), design.shape[1])
    rough = SMOOTHNESS * np.sqrt(len(force)) * (steps[len(SPEEDS) - 1 :] - steps[: 1 - len(SPEEDS)])
    normal = design.T @ design + rough.T @ rough + 1e-9 * len(force) * np.eye(design.shape[1])
    values = np.linalg.solve(normal, design.T @ force)
    left = float(np.var(force - design @ values) / np.var(force))
    return np.insert(values[:-1].reshape(LEVELS, -1), ZERO, 0.0, axis=1), left


def _hats(values: F, knots: F) -> F:
    """Return the hat functions (n, knots) of values, which are clipped at the ends."""
    inside = np.clip(values, knots[0], knots[-1])
    return np.stack([np.interp(inside, knots, one) for one in np.eye(len(knots))], axis=1)


def _rise(table: F, largest: float) -> F:
    """Return the table with forces that rise with speed on both sides of zero."""
    least = MIN_SLOPE * largest * np.array(SPEEDS)
    right = np.maximum.accumulate(np.maximum(table - least, 0.0)[:, ZERO:], axis=1)
    left = np.minimum.accumulate(np.minimum(table - least, 0.0)[:, ZERO::-1], axis=1)[:, ::-1]
    return np.concatenate([left[:, :-1], right], axis=1) + least
