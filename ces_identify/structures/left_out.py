"""Data that short fits of several structures do not see, and the comparison of these structures on them.

Where recordings consist of held conditions, as sines at a few peak speeds for each of a few currents, whole conditions
are left out: other blocks of the same sines would say nothing about what lies between them. Elsewhere blocks are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from ces_data.arrays import F, I, Mask
from ces_identify.polynomial.problem import MIN_TICKS, estimation_ticks
from ces_identify.prepare.series import Series

BLOCK_S, EVERY = 3.0, 4  # every fourth block is left out; a short series has BLOCKS of them
BLOCKS = 8
WINDOW_S = 1.0  # in which the current is constant and the speed reaches its peak
UNIT_S = 1.0  # of a block that counts as one observation, CONDITION_S of a condition
CONDITION_S = 3.0
CONSTANT = 0.08  # of the range of currents, at least SMALL of the largest: change within a window with a held current
SMALL = 0.25
HELD = 0.9  # share of the windows with a held current
CURRENT_LEVELS = 0.08, 0.02, HELD  # gap between two, as a share of the range; share of the windows, at one and at all
SPEED_LEVELS = 0.05, 0.08, 0.6  # the same; the gap is of logarithms, and windows between two conditions are at none
MIN_LEVELS, MAX_LEVELS = 3, 12  # of which inner ones are left out
FOLDS = 2
LEVEL = 0.95


@dataclass(frozen=True)
class LeftOut:
    """Ticks that a fit does not see: by series a mask, and the number of the observation to which a tick belongs."""

    about: str
    masks: tuple[Mask, ...]
    units: tuple[I, ...]

    def hide(self, series: Sequence[Series]) -> list[Series]:
        """Return the series without their measured force on these ticks, and without those that have none then."""
        hidden = [
            replace(one, force=np.where(mask, np.nan, one.force), scored=one.scored & ~mask)
            for one, mask in zip(series, self.masks, strict=True)
        ]
        return [one for one in hidden if one.scored.any()]

    def squares(self, series: Sequence[Series], forces: Sequence[F]) -> F:
        """Return the sum of squared errors of each observation relative to its recording's force variance, and ticks.

        The shape is (2, observations).
        """
        count = 1 + max(int(unit.max()) for unit in self.units)
        sums = np.zeros((2, count))
        for one, mask, unit, force in zip(series, self.masks, self.units, forces, strict=True):
            ticks = mask & one.scored
            error = (one.force[ticks] - force[ticks]) ** 2 / one.force[one.scored].var()
            sums += [np.bincount(unit[ticks], weight, count) for weight in (error, np.ones(int(ticks.sum())))]
        return sums


@dataclass(frozen=True)
class CostRatio:
    """The ratio of the cost of structure `second` to that of `first`, with the ends of its 95 % interval."""

    first: str
    second: str
    ratio: float
    low: float
    high: float

    @property
    def is_none(self) -> bool:
        """Whether the interval includes no difference."""
        return not (self.low > 1.0 or self.high < 1.0)


def cost_of(squares: F) -> float:
    """Return J [%] of the sums (2, observations) of `LeftOut.squares`."""
    return float(100.0 * np.sqrt(squares[0].sum() / squares[1].sum()))


def compare_costs(squares: Mapping[str, F], first: str, second: str) -> CostRatio:
    """Return the difference of two structures, with a t interval of the logarithm over the observations."""
    a, b = (squares[name][0, squares[name][1] > 0.0] for name in (first, second))
    change = 0.5 * (b / b.sum() - a / a.sum())
    n, mean = len(change), 0.5 * float(np.log(b.sum() / a.sum()))
    error = np.sqrt(n / max(n - 1, 1) * float(change @ change))
    half = float(stdtrit(n - 1, 0.5 + LEVEL / 2.0)) * error if n > 1 else np.inf
    return CostRatio(first, second, *(float(np.exp(x)) for x in (mean, mean - half, mean + half)))


def choose_left_out(series: Sequence[Series]) -> list[LeftOut]:
    """Return what is left out in turn: inner conditions if the recordings hold some and enough else, or blocks."""
    conditions = _conditions(series)
    rest = [one for fold in conditions for one in fold.hide(series)]
    fit = [(one.scored & mask).sum() for one in rest for ticks in [estimation_ticks(one)] for mask in (ticks, ~ticks)]
    return conditions if conditions and min(fit) >= MIN_TICKS else [_blocks(series)]


def _blocks(series: Sequence[Series]) -> LeftOut:
    """Return every EVERY-th block of each series; observations are UNIT_S long."""
    masks, units, count = [], [], 0
    for one in series:
        seconds = np.arange(len(one)) / one.rate_Hz
        block = min(BLOCK_S, len(one) / one.rate_Hz / BLOCKS)
        masks.append((seconds // block).astype(np.int64) % EVERY == EVERY - 1)
        units.append(count + (seconds // UNIT_S).astype(np.int64))
        count = int(units[-1].max()) + 1
    return LeftOut(f"every fourth block of {BLOCK_S:g} s", tuple(masks), tuple(units))


def _conditions(series: Sequence[Series]) -> list[LeftOut]:
    """Return inner currents and peak speeds that are left out in turn, if the current is held and there are some."""
    windows = [_windows(one) for one in series]
    current, change, speed = (np.concatenate(rows) for rows in zip(*windows, strict=True))
    span = max(float(np.ptp(current)), SMALL * float(np.abs(current).max()), 1e-9)
    if np.mean(change <= CONSTANT * span) < HELD:
        return []
    currents = span * _find_levels(current / span, *CURRENT_LEVELS)
    speeds = np.exp(_find_levels(np.log(np.maximum(speed, 1e-6)), *SPEED_LEVELS))
    folds: list[LeftOut] = []
    for k in range(FOLDS):
        chosen = [_inner(currents, k), _inner(speeds, FOLDS - 1 - k)]
        names = [
            f"{name} {value:.3g} {unit}"
            for name, unit, value in zip(("current", "peak speed"), ("A", "m/s"), chosen, strict=True)
            if value is not None
        ]
        if names and names not in [fold.about.split(" and ") for fold in folds]:
            folds.append(_hold_out(" and ".join(names), series, windows, (currents, speeds), chosen))
    return folds


def _windows(series: Series) -> F:
    """Return the middle current [A], its change and the peak speed [m/s] of each window (3, windows)."""
    length = max(1, min(round(WINDOW_S * series.rate_Hz), len(series)))
    count = len(series) // length
    current, speed = (one[: count * length].reshape(count, length) for one in (series.current, series.speed))
    change = np.subtract(*np.quantile(current, (0.9, 0.1), axis=1))
    return np.array([np.median(current, axis=1), change, np.abs(speed).max(axis=1)])


def _find_levels(values: F, gap: float, at_one: float, at_all: float) -> F:
    """Return the levels at which most of `values` (n,) are; none if there are too few or too many."""
    ordered = np.sort(values)
    groups = np.split(ordered, 1 + np.flatnonzero(np.diff(ordered) > gap))
    groups = [one for one in groups if len(one) >= at_one * len(values) and np.ptp(one) <= 2.0 * gap]
    enough = sum(map(len, groups)) >= at_all * len(values) and MIN_LEVELS <= len(groups) <= MAX_LEVELS
    return np.array([np.median(one) for one in groups]) if enough else np.empty(0)


def _inner(levels: F, fold: int) -> float | None:
    """Return the level that a fold leaves out, never the lowest or the highest."""
    inner = levels[1:-1]
    return float(inner[fold * (len(inner) - 1) // (FOLDS - 1)]) if len(inner) else None


def _hold_out(
    about: str,
    series: Sequence[Series],
    windows: Sequence[F],
    levels: tuple[F, F],
    chosen: Sequence[float | None],
) -> LeftOut:
    """Return the windows nearest to a chosen current or peak speed; observations are at most CONDITION_S long."""
    masks, units, count = [], [], 0
    for one, (current, _, speed) in zip(series, windows, strict=True):
        near = [
            np.full(len(values), value is not None) & (_nearest(values, at) == (value or 0.0))
            for values, at, value in zip((current, speed), levels, chosen, strict=True)
        ]
        at = np.minimum(np.arange(len(one)) // max(1, round(WINDOW_S * one.rate_Hz)), len(current) - 1)
        masks.append((near[0] | near[1])[at])
        units.append(count + (np.arange(len(one)) / one.rate_Hz // CONDITION_S).astype(np.int64))
        count = int(units[-1].max()) + 1
    return LeftOut(about, tuple(masks), tuple(units))


def _nearest(values: F, levels: F) -> F:
    """Return the nearest level of each value (n,)."""
    if not len(levels):
        return np.full(len(values), np.nan)
    return np.asarray(levels[np.argmin(np.abs(values[:, None] - levels), axis=1)])
