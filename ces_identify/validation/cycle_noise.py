"""The noise floor from repeated cycles: what differs between cycles of the same stroke and current is noise.

No model of position and current can explain it, so it is a lower limit of J. At every tick the force is compared with
the mean of the previous and the next cycle at the same phase: d = y(t) - (y(t - T) + y(t + T)) / 2. What the cycles
have in common and linear drift cancel; independent noise of variance s2 gives d2 a mean of (1 + 1/2) s2 (Gasser, Sroka
& Jennen-Steinmetz, Biometrika 73, 1986). T is the smallest number of periods that is close to whole ticks, because
interpolation would add errors. The floor is that of the force interpolated at the ticks. Noise slower than a cycle
cancels; differences of stroke or current between cycles count as noise, so both must repeat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F, I
from ces_identify.limits import CycleLimits
from ces_identify.prepare.series import Series

PEAK, MAX_PEAKS = 0.9, 50  # autocorrelation at which a lag may be the period; how many are tried
OFF_TICK = 0.1  # ticks by which a lag may be off a whole number
MAX_PERIODS = 10  # combined into one lag


@dataclass(frozen=True)
class CycleNoise:
    """Noise `noise_N` (RMS) from cycles of `period_s`, and the cost J [%] that it causes (`floor`)."""

    period_s: float
    cycles: int
    noise_N: float
    floor: float


def cycle_noise(series: Series) -> CycleNoise | str:
    """Return the noise floor of `series` if its stroke and current are periodic, else the reason why there is none.

    Single cycles that differ from their neighbours, such as where the rig fades in and out, are skipped.
    """
    starts = np.minimum(series.segments[:, 0] + series.warm_up, series.segments[:, 1])
    settled = np.stack([starts, series.segments[:, 1]], axis=1)
    start, stop = settled[np.argmax(settled[:, 1] - settled[:, 0])]
    if stop - start < 2 * CycleLimits.MIN_CYCLES:
        return "too short to settle"
    period = find_period(series.position[start:stop])
    if period is None:
        return "the stroke does not repeat"
    cycle, lag = (np.arange(len(series)) / period).astype(np.int64), whole_ticks(period)
    stroke = _rms_by_cycle(differences(series.position, settled, lag), cycle) / float(series.position[start:stop].std())
    current = _rms_by_cycle(differences(series.current, settled, lag), cycle) / max(_rms(series.current), 1e-12)
    finite = np.isfinite(stroke) & np.isfinite(current)
    for name, mismatch in (("stroke", stroke), ("current", current)):
        if finite.any() and np.median(mismatch[finite]) > CycleLimits.MISMATCH:
            share = 100.0 * np.median(mismatch[finite])
            return f"the stroke repeats, but from cycle to cycle the {name} differs by {share:.1f} %"
    same = finite & (stroke <= CycleLimits.MISMATCH) & (current <= CycleLimits.MISMATCH)
    force = differences(np.where(series.scored, series.force, np.nan), settled, lag)
    used = force[same[cycle] & np.isfinite(force)]
    cycles = int(len(used) / period)
    if cycles < CycleLimits.MIN_CYCLES:
        return f"{cycles} equal cycles with a measured force; expected at least {CycleLimits.MIN_CYCLES}"
    noise = _rms(used)
    return CycleNoise(period / series.rate_Hz, cycles, noise, 100.0 * noise / float(series.force[series.scored].std()))


def find_period(x: F, min_period: float = 2.0) -> float | None:
    """Return the shortest period [ticks] of x (n,) above `min_period`, or None if x does not repeat.

    Candidates are the high peaks of the autocorrelation after its first zero crossing: the first at which most of x
    repeats, else the highest. The period is refined at its latest multiple with half of x to compare.
    """
    rho = _overlap_correlation(x, len(x) // 2)
    negative = np.flatnonzero(rho < 0.0)
    if not len(negative):
        return None
    inner = np.arange(max(int(negative[0]), int(min_period), 2), len(rho) - 1)
    peaks = inner[(rho[inner] >= rho[inner - 1]) & (rho[inner] > rho[inner + 1]) & (rho[inner] > PEAK)]
    if not len(peaks):
        return None
    periods = (_refine_period(rho, float(place)) for place in peaks[:MAX_PEAKS])
    best = _refine_period(rho, float(peaks[np.argmax(rho[peaks])]))
    return next((p for p in periods if _is_periodic(x, p)), best)


def whole_ticks(period: float, max_periods: int = MAX_PERIODS) -> int:
    """Return the fewest periods within OFF_TICK of a whole number, in ticks; else the nearest."""
    multiples = period * np.arange(1, max_periods + 1)
    off = np.abs(multiples - np.rint(multiples))
    near = off <= OFF_TICK
    return round(float(multiples[np.argmax(near) if near.any() else np.argmin(off)]))


def differences(x: F, runs: I, lag: int) -> F:
    """Return x minus the mean of x `lag` ticks before and after, scaled to the RMS of the noise in x.

    The result (n,) is NaN within `lag` ticks of either end of the `runs`, and where x is NaN.
    """
    result = np.full(len(x), np.nan)
    for start, stop in runs:
        ticks = np.arange(start + lag, stop - lag)
        result[ticks] = (x[ticks] - 0.5 * (x[ticks - lag] + x[ticks + lag])) / np.sqrt(1.5)
    return result


def _rms_by_cycle(difference: F, cycle: I) -> F:
    """Return the RMS of the differences in each cycle, NaN where fewer than half its ticks have one."""
    finite = np.isfinite(difference)
    ticks, all_ticks = np.bincount(cycle, finite), np.bincount(cycle)
    squares = np.bincount(cycle, np.where(finite, difference, 0.0) ** 2)
    return np.where(2 * ticks >= all_ticks, np.sqrt(squares / np.maximum(ticks, 1)), np.nan)


def _overlap_correlation(x: F, max_lag: int) -> F:
    """Return the correlation of x with itself at lags 0 to `max_lag`, each over the overlap: 1 at a true period."""
    centred = x - x.mean()
    size = 1 << (len(x) + max_lag).bit_length()
    products = np.fft.irfft(np.abs(np.fft.rfft(centred, size)) ** 2, size)[: max_lag + 1]
    energy = np.concatenate([[0.0], np.cumsum(centred**2)])
    lags = np.arange(max_lag + 1)
    both = energy[len(x) - lags] + (energy[-1] - energy[lags])
    return np.asarray(2.0 * products / np.maximum(both, 1e-300))


def _refine_period(rho: F, period: float) -> float:
    """Return the period near `period` from the peaks at the period, its double, and so on."""
    times = 1
    while True:
        top = _find_peak(rho, round(times * period))
        period = top / times
        times *= 2
        if times * period >= len(rho) - 4:
            return period


def _find_peak(rho: F, near: int) -> float:
    """Return the position of the peak within two ticks of `near`, by a parabola."""
    begin = max(near - 2, 1)
    top = min(begin + int(np.argmax(rho[begin : near + 3])), len(rho) - 2)
    curvature = rho[top - 1] - 2.0 * rho[top] + rho[top + 1]
    return top + (float(0.5 * (rho[top - 1] - rho[top + 1]) / curvature) if curvature < 0.0 else 0.0)


def _is_periodic(x: F, period: float) -> bool:
    """Return whether x equals x one period before and after at most of its ticks."""
    difference = np.abs(differences(x, np.array([[0, len(x)]]), whole_ticks(period)))
    values = difference[np.isfinite(difference)]
    return bool(len(values)) and float(np.median(values)) <= CycleLimits.MISMATCH * float(x.std())


def _rms(x: F) -> float:
    return float(np.sqrt(np.mean(x**2))) if len(x) else 0.0
