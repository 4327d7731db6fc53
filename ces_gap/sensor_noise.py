"""The noise of a measured force on the grid of its trace, from independent sources; the smallest bound counts.

The sources are single samples of the channel (its highest frequencies, the step of the logged values), repeated cycles
(forces at equal phase differ by noise only), and standstill (the force is constant but for noise and slow trends).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import toeplitz

from ces_data.arrays import F, I, Mask
from ces_gap.grid import rms
from ces_gap.limits import DiagnosisLimits, NoiseLimits
from ces_identify.limits import CycleLimits, TickLimits
from ces_identify.validation.cycle_noise import differences, find_period, whole_ticks

CYCLES = "repeated cycles"
STANDSTILL = "standstill"
HIGH_FREQUENCIES = "high frequencies"
QUANTUM = "sensor quantum"
NO_SOURCE = "no source"


@dataclass(frozen=True)
class GridSignals:
    """What was measured, on the grid of a trace: arrays (n,) of position [m], speed, acceleration, current, force."""

    rate_Hz: float
    position: F
    speed: F
    acceleration: F
    current: F
    force: F
    usable: Mask


@dataclass(frozen=True)
class NoiseEstimate:
    """What one source says about the noise on the grid, `rms_N` [N]; `problem` says why it is not valid, if it is not.

    `lag1` is the autocorrelation of the noise from tick to tick, NaN if the source does not show it.
    """

    source: str
    rms_N: float
    problem: str = ""
    lag1: float = math.nan

    @property
    def valid(self) -> bool:
        """Whether the noise is at most `rms_N` according to this source."""
        return not self.problem


@dataclass(frozen=True)
class MeasuredNoise:
    """The noise of the measured force on the grid, RMS [N], its `source`, and the `estimates` of all sources.

    It is `known` if at least one source limits it from above; otherwise `rms_N` is only the best guess. The share
    `passes` of the noise of the logged samples is left on the grid, which has a narrower band.
    """

    rms_N: float
    source: str
    estimates: tuple[NoiseEstimate, ...] = ()
    known: bool = False
    passes: float = 1.0

    def describe_source(self) -> str:
        """Return the source in a few words, as in `8.1 N from repeated cycles`."""
        return self.source if self.known else f"{self.source}, not limited by any source"


UNMEASURED = MeasuredNoise(0.0, NO_SOURCE)


def measure_noise(
    samples: F, resample: Callable[[F], F], signals: GridSignals, simulated: F | None = None
) -> MeasuredNoise:
    """Return the noise of the force on the grid: the smallest valid upper bound, otherwise the largest lower bound.

    `samples` [N] (m,) are the logged forces, `simulated` [N] (m,) those of a simulation, NaN where it has none;
    `resample` returns m values on the grid (n,).
    """
    known = np.isfinite(samples)
    values = samples[known]
    if not signals.usable.any() or not len(values) or np.ptp(values) == 0.0:
        return UNMEASURED
    white = resample(np.random.default_rng(0).standard_normal(len(samples)))  # resampling attenuates noise
    on_grid, white_lag1 = float(white.std()), correlate_neighbours(white, np.ones(len(white), bool))
    quantum = find_quantum_N(values)
    floor = NoiseEstimate(QUANTUM, quantum / math.sqrt(12.0) * on_grid, "a lower bound")
    repeated = [estimate_from_cycles(signals), estimate_from_standstill(signals)]
    errors = np.array([]) if simulated is None else (samples - simulated)[known & np.isfinite(simulated)]
    high = estimate_from_differences(values, errors, quantum, on_grid)
    coloured = next((e for e in repeated if e.valid and e.lag1 > white_lag1 + NoiseLimits.MAX_COLOUR), None)
    if coloured is not None and high.valid:
        high = replace(high, problem=f"the noise at {coloured.source} is not white")
    estimates = [*repeated, high]
    valid = [e for e in estimates if e.valid]
    best = min(valid, key=lambda e: e.rms_N) if valid else max([*estimates, floor], key=lambda e: e.rms_N)
    if best.rms_N < floor.rms_N:
        best = floor
    passes = on_grid if coloured is None else 1.0  # noise that a filter has left lies in the band of the grid
    return MeasuredNoise(best.rms_N, best.source, (*estimates, floor), bool(valid), passes)


ORDER = 6  # of the differences that show the noise: a force that is smooth over as many samples vanishes in them
WINDOW = 8  # differences in a window
QUIET = 0.25  # share of the windows that count as quiet: not during a reversal or a step
WHITE_SAMPLES = 200_000  # of white noise of 1 N, which calibrates the levels
MAX_STEPS = 1e6  # of the quantum in the largest difference; finer steps are rounding of the file's numbers


def find_quantum_N(values: F) -> float:
    """Return the step [N] of which all differences of logged values (n,) are multiples, 0 if there is none."""
    differences = np.abs(np.diff(values))
    largest = float(differences.max(initial=0.0))
    steps = np.unique(np.round(differences[differences > largest / MAX_STEPS] / max(largest, 1e-300), 9)) * largest
    if not len(steps) or len(steps) > len(values) / 2:
        return 0.0
    step = float(steps[0])
    for reach in (5.0, 20.0, 100.0, 1000.0):  # fits ever larger differences: the file's numbers may be rounded
        near = differences[differences < reach * step]
        counts = np.round(near / step)
        step = float(counts @ near / max(float(counts @ counts), 1e-300)) or step
    off = np.abs(differences / step - np.round(differences / step))
    return step if float(np.quantile(off, 0.9)) < 0.05 else 0.0


def estimate_from_differences(values: F, errors: F, quantum_N: float, on_grid: float) -> NoiseEstimate:
    """Return white noise as strong as the differences of high order of the logged samples `values` [N] (n,).

    The `errors` [N] of a simulation hold the same noise and less of the damper's force: the smaller of the two counts.
    White noise of 1 N at the samples is `on_grid` [N] on the grid.
    """
    if len(values) < TickLimits.MIN_ERRORS:
        return NoiseEstimate(HIGH_FREQUENCIES, 0.0, f"{len(values)} samples")
    some = [values, errors] if len(errors) >= TickLimits.MIN_ERRORS else [values]
    quietest = min(some, key=lambda samples: _quiet_power(samples, ORDER))
    orders = (ORDER, *(order for order, _ in NoiseLimits.MAX_FALL))
    power, *low = (_quiet_power(quietest, k) / _quiet_power_of_white_noise(k) for k in orders)
    problem = ""
    if power < NoiseLimits.MIN_OVER_QUANTUM * quantum_N**2 / 12.0:
        problem = "the spectrum ends at the noise of the quantisation"
    elif all(level > fall * power for level, (_, fall) in zip(low, NoiseLimits.MAX_FALL, strict=True)):
        problem = "the spectrum still falls at its top"
    return NoiseEstimate(HIGH_FREQUENCIES, float(np.sqrt(power)) * on_grid, problem)


@cache
def _quiet_power_of_white_noise(order: int) -> float:
    return _quiet_power(np.random.default_rng(1).standard_normal(WHITE_SAMPLES), order)


def _quiet_power(values: F, order: int) -> float:
    """Return the mean square [N²] of the differences of an `order` in quiet windows."""
    differences_N = np.diff(values, order)
    windows = differences_N[: len(differences_N) // WINDOW * WINDOW].reshape(-1, WINDOW)
    return float(np.quantile((windows**2).mean(1), QUIET))


MAX_PERIODS = 10  # between the cycles that are compared, so that they are whole ticks apart
KNOTS = (-1.4, -0.7, -0.25, 0.0, 0.25, 0.7, 1.4)  # speed over its RMS, where the slopes of the force may change


def estimate_from_cycles(signals: GridSignals) -> NoiseEstimate:
    """Return the RMS of what differs between equal cycles."""
    period = find_period(signals.position, NoiseLimits.MIN_PERIOD_S * signals.rate_Hz)
    if period is None:
        return NoiseEstimate(CYCLES, 0.0, "the position does not repeat")
    cycle = np.arange(len(signals.force)) // round(period)
    ticks = np.bincount(cycle)
    mean = np.bincount(cycle, signals.position) / ticks
    energy = np.bincount(cycle, (signals.position - mean[cycle]) ** 2) / ticks
    moving = signals.usable & (np.sqrt(energy) >= NoiseLimits.MIN_MOTION * signals.position.std())[cycle]
    spare = (moving.sum() / period - CycleLimits.MIN_CYCLES) / 2.0
    lag = whole_ticks(period, int(np.clip(spare, 1, MAX_PERIODS)))
    used = _find_equal_ticks(signals, moving, lag, cycle)
    if used.sum() < CycleLimits.MIN_CYCLES * period:
        return NoiseEstimate(
            CYCLES, 0.0, f"{int(used.sum() / period)} equal cycles; expected at least {CycleLimits.MIN_CYCLES}"
        )
    target, rows = _differences(signals.force, lag)[used], _motion_differences(signals, lag)[used]
    left = target - rows @ np.linalg.lstsq(rows, target, rcond=1e-9)[0]
    rms_N = float(np.sqrt(left @ left / max(len(left) - rows.shape[1], 1)))
    return NoiseEstimate(CYCLES, rms_N, lag1=correlate_neighbours(left, used))


def correlate_neighbours(values: F, used: Mask) -> float:
    """Return the autocorrelation from tick to tick of `values` (m,) at the `used` ticks (n,)."""
    on_grid = np.zeros(len(used))
    on_grid[used] = values
    pairs = used[:-1] & used[1:]
    energy = float((on_grid[:-1] ** 2)[pairs].sum())
    return float((on_grid[:-1] * on_grid[1:])[pairs].sum()) / max(energy, 1e-300)


def _find_equal_ticks(signals: GridSignals, moving: Mask, lag: int, cycle: I) -> Mask:
    """Return the ticks (n,) in a `cycle` that equals those `lag` ticks before and after, all three `moving`."""
    n = len(signals.force)
    used = np.zeros(n, bool)
    if 2 * lag >= n:
        return used
    used[lag : n - lag] = moving[lag : n - lag] & moving[: n - 2 * lag] & moving[2 * lag :]
    for values, spread in ((signals.position, signals.position.std()), (signals.current, rms(signals.current))):
        difference = np.nan_to_num(_differences(values, lag))
        energy = np.bincount(cycle, np.where(used, difference**2, 0.0)) / np.maximum(np.bincount(cycle, used), 1)
        used &= (np.sqrt(energy) <= NoiseLimits.MAX_MISMATCH * max(float(spread), 1e-12))[cycle]
    return used


def _motion_differences(signals: GridSignals, lag: int) -> F:
    """Return the differences of the inputs between cycles, times a few functions of the state (n, q)."""
    speed = signals.speed / max(rms(signals.speed), 1e-12)
    current = signals.current / max(rms(signals.current), 1e-12)
    hat_functions = [np.interp(speed, KNOTS, hat) for hat in np.eye(len(KNOTS))]  # of speed, each 1 at one of the KNOTS
    states = (*hat_functions, current)
    moved = (signals.position, signals.speed, signals.acceleration, signals.current)
    rows = [_differences(values, lag) / max(float(values.std()), 1e-12) * s for values in moved for s in states]
    return np.stack(rows, axis=1)


def _differences(values: F, lag: int) -> F:
    """Return what the values (n,), one run, differ by from those `lag` ticks before and after."""
    return differences(values, np.array([[0, len(values)]]), lag)


WINDOW_S = 0.5  # [s] in which the force may change quadratically
TREND = 5  # coefficients of the trend in a window


def estimate_from_standstill(signals: GridSignals) -> NoiseEstimate:
    """Return the RMS of the force about its trend in windows without motion, the median of the windows."""
    width = max(round(WINDOW_S * signals.rate_Hz), 16)
    starts = _find_still_windows(signals, width)
    if len(starts) < NoiseLimits.MIN_WINDOWS:
        return NoiseEstimate(STANDSTILL, 0.0, "the damper hardly ever rests")
    left = np.stack([_remove_trend(signals, slice(k, k + width)) for k in starts])
    energy = (left**2).sum(1)
    middle = left[np.argsort(energy)[len(energy) // 2]]
    lag1 = correlate_neighbours(middle, np.ones(width, bool))
    return NoiseEstimate(STANDSTILL, float(np.sqrt(np.median(energy) / _ticks_left(width, lag1))), lag1=lag1)


def _ticks_left(width: int, lag1: float) -> float:
    """Return the energy that a trend leaves of noise of 1 N, in ticks: it takes more of autocorrelated noise."""
    trend: F = np.linalg.qr(_polynomial(width))[0]
    correlation = toeplitz(max(lag1, 0.0) ** np.arange(width))
    return width - float(np.trace(trend.T @ correlation @ trend)) - TREND + len(trend[0])


def _polynomial(width: int) -> F:
    return np.vander(np.linspace(-1.0, 1.0, width), 3)


def _remove_trend(signals: GridSignals, window: slice) -> F:
    """Return the force in a window less a quadratic trend and what remains of position and speed in it."""
    force = signals.force[window]
    moved = np.stack([signals.position[window], signals.speed[window]], axis=1)
    rows = np.hstack([_polynomial(len(force)), (moved - moved.mean(0)) / np.maximum(moved.std(0), 1e-12)])
    return np.asarray(force - rows @ np.linalg.lstsq(rows, force, rcond=1e-9)[0])


def _find_still_windows(signals: GridSignals, width: int) -> list[int]:
    """Return the first ticks of windows without motion, none overlapping."""
    if len(signals.force) < width:
        return []
    move = max(NoiseLimits.MAX_MOVE * float(signals.position.std()), NoiseLimits.MAX_MOVE_M)
    current = DiagnosisLimits.CONSTANT * rms(signals.current)
    still = sliding_window_view(signals.usable, width).all(1)
    for values, most in ((signals.position, move), (signals.current, current + 1e-9)):
        still &= sliding_window_view(values, width).std(1) <= most
    starts, free = [], 0
    for start in np.flatnonzero(still):
        if start >= free:
            starts.append(int(start))
            free = int(start) + width
    return starts
