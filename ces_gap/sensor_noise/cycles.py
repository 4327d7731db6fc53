"""Noise from repeated cycles: where position and current repeat, forces at equal phase differ by noise only.

At each tick the force is compared with the mean of the cycles before and after, so that the common force and linear
drift cancel (`ces_identify.validation.cycle_noise`). What slight differences of position, speed, acceleration and
current explain, with slopes that depend on speed and current, is removed by regression. Low frequencies remain, down to
that of the cycle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_gap.sensor_noise.noise_estimate import CYCLES, B, F, GridSignals, NoiseEstimate
from ces_identify.validation.cycle_noise import differences, find_period, whole_ticks

MIN_PERIOD_S = 0.05
MIN_CYCLES = 5
MAX_PERIODS = 10  # between the cycles that are compared, so that they are whole ticks apart
MAX_MISMATCH = 0.02  # RMS difference of a cycle from its neighbours, over the spread of the position or the current
KNOTS = (-1.4, -0.7, -0.25, 0.0, 0.25, 0.7, 1.4)  # speed over its RMS, where the slopes of the force may change
MIN_MOTION = 0.5  # spread of the position in a cycle, over that in the recording


def estimate_from_cycles(signals: GridSignals) -> NoiseEstimate:
    """Return the RMS of what differs between equal cycles."""
    period = find_period(signals.position, MIN_PERIOD_S * signals.rate_Hz)
    if period is None:
        return NoiseEstimate(CYCLES, 0.0, "the position does not repeat")
    moving = _find_moving_ticks(signals, round(period))
    spare = (moving.sum() / period - MIN_CYCLES) / 2.0
    lag = whole_ticks(period, int(np.clip(spare, 1, MAX_PERIODS)))
    used = _find_equal_ticks(signals, moving, lag, round(period))
    if used.sum() < MIN_CYCLES * period:
        return NoiseEstimate(CYCLES, 0.0, f"{int(used.sum() / period)} equal cycles; expected at least {MIN_CYCLES}")
    target = differences(signals.force, _whole(signals), lag)[used]
    rows = _motion_differences(signals, lag)[used]
    left = target - rows @ np.linalg.lstsq(rows, target, rcond=1e-9)[0]
    rms = float(np.sqrt(left @ left / max(len(left) - rows.shape[1], 1)))
    return NoiseEstimate(CYCLES, rms, lag1=correlate_neighbours(left, used))


def correlate_neighbours(values: F, used: B) -> float:
    """Return the autocorrelation from tick to tick of `values` (m,) at the `used` ticks (n,)."""
    on_grid = np.zeros(len(used))
    on_grid[used] = values
    pairs = used[:-1] & used[1:]
    energy = float((on_grid[:-1] ** 2)[pairs].sum())
    return float((on_grid[:-1] * on_grid[1:])[pairs].sum()) / max(energy, 1e-300)


def _find_moving_ticks(signals: GridSignals, period: int) -> B:
    """Return the usable ticks (n,) in cycles with motion."""
    cycle = np.arange(len(signals.force)) // period
    ticks = np.bincount(cycle)
    mean = np.bincount(cycle, signals.position) / ticks
    energy = np.bincount(cycle, (signals.position - mean[cycle]) ** 2) / ticks
    return np.asarray(signals.usable & (np.sqrt(energy) >= MIN_MOTION * signals.position.std())[cycle])


def _find_equal_ticks(signals: GridSignals, moving: B, lag: int, period: int) -> B:
    """Return the ticks (n,) in cycles that equal those `lag` ticks before and after, all three `moving`."""
    n = len(signals.force)
    used = np.zeros(n, bool)
    if 2 * lag >= n:
        return used
    used[lag : n - lag] = moving[lag : n - lag] & moving[: n - 2 * lag] & moving[2 * lag :]
    cycle = np.arange(n) // period
    for values, spread in ((signals.position, signals.position.std()), (signals.current, _rms(signals.current))):
        difference = np.nan_to_num(differences(values, _whole(signals), lag))
        energy = np.bincount(cycle, np.where(used, difference**2, 0.0)) / np.maximum(np.bincount(cycle, used), 1)
        used &= (np.sqrt(energy) <= MAX_MISMATCH * max(float(spread), 1e-12))[cycle]
    return used


def _motion_differences(signals: GridSignals, lag: int) -> F:
    """Return the differences of the inputs between cycles, times a few functions of the state (n, q)."""
    run = _whole(signals)
    speed = signals.speed / max(_rms(signals.speed), 1e-12)
    current = signals.current / max(_rms(signals.current), 1e-12)
    states = (*_hats(speed), current)
    moved = (signals.position, signals.speed, signals.acceleration, signals.current)
    rows = [differences(values, run, lag) / max(float(values.std()), 1e-12) * s for values in moved for s in states]
    return np.stack(rows, axis=1)


def _hats(speed: F) -> list[F]:
    """Return piecewise linear functions of the speed over its RMS (n,), each 1 at one of the KNOTS."""
    return [np.interp(speed, KNOTS, np.eye(len(KNOTS))[k]) for k in range(len(KNOTS))]


def _whole(signals: GridSignals) -> NDArray[np.int64]:
    """Return the one run (1, 2) of all ticks."""
    return np.array([[0, len(signals.force)]])


def _rms(values: F) -> float:
    return float(np.sqrt(np.mean(values**2)))
