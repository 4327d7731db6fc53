"""Delays between channels, estimated with an interval: how late force or current are logged relative to the position.

A damper's force depends on motion and current until now, never on those to come. For every shift of a channel, a
flexible causal map of position, speed and current, with memory, is fitted to the force by least squares; it contains
the lags that dampers have. The relative error of the fit is least at the right shift. All shifts that fit almost as
well form the interval: where a lag of the damper or of its valve could imitate the delay, as with a single sine, the
interval is wide and holds zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ces_identify.numerics.arrays import F, I
from ces_identify.sense.motion import RATE_HZ, Motion

MAX_DELAY_S = 0.07
MIN_TICKS = 2000
ROWS, CURRENT_ROWS = 8000, 5000  # of the regressions
KNOTS = (0.0, 0.02, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98, 1.0)  # quantiles of the speed
CURRENT_KNOTS = (0.0, 0.03, 0.2, 0.4, 0.6, 0.8, 0.97, 1.0)
LAGS_S = (0.0, 0.003, 0.008)  # memory of the force
VALVE_LAGS_S = (0.0, 0.01, 0.025)
CURRENT_STEP = 2  # ticks between shifts of the current
RIDGE = 1e-5
FACTOR, FLOOR = 1.35, 0.02  # error that still counts as a fit: a multiple of the least, and never below the floor
CURRENT_FACTOR, CURRENT_FLOOR = 1.25, 0.03
MAX_ERROR = 0.6  # of the best fit; beyond it the force is not that of these signals
SAME_CURRENT = 0.02  # relative spread below which a current counts as constant


@dataclass(frozen=True)
class DelayEstimate:
    """How late a signal is logged [s], with the interval of the shifts that fit; `errors` at zero and at the best."""

    late_s: float
    low_s: float
    high_s: float
    error_at_zero: float
    least_error: float

    @property
    def certain(self) -> bool:
        """Whether the interval does not hold zero."""
        return self.low_s > 0.0 or self.high_s < 0.0

    @property
    def nearest_s(self) -> float:
        """The end of the interval that is nearer to zero, 0 if zero is inside."""
        return min((self.low_s, self.high_s), key=abs) if self.certain else 0.0


def force_delay(motion: Motion) -> DelayEstimate | None:
    """Return how late the force is logged relative to the position, None if that cannot be known."""
    if len(motion) < MIN_TICKS or motion.speed.std() == 0.0 or motion.force.std() == 0.0:
        return None
    features, reach = _force_features(motion), round(MAX_DELAY_S * RATE_HZ)
    rows = _rows(len(motion), reach, ROWS)
    shifts = np.arange(-reach, reach + 1)
    targets = np.stack([motion.force[rows + shift] for shift in shifts], axis=1)
    errors = _fit_errors(features[:, rows].T, targets)
    return _as_delay(shifts / RATE_HZ, errors, FACTOR, FLOOR)


def current_delay(motion: Motion, force_late_s: float = 0.0) -> DelayEstimate | None:
    """Return how late the current is logged relative to the force, None if that cannot be known.

    `force_late_s` is the delay of the force relative to the position, which is taken out first.
    """
    if len(motion) < MIN_TICKS or is_constant(motion.current) or motion.speed.std() == 0.0:
        return None
    reach, late = round(MAX_DELAY_S * RATE_HZ), round(force_late_s * RATE_HZ)
    rows = _rows(len(motion), reach + abs(late), CURRENT_ROWS)
    motion_part, speed_hats = _motion_features(motion)
    currents = _currents(motion.current)
    shifts = np.arange(-reach, reach + 1, CURRENT_STEP)
    target = motion.force[rows + late][:, None]
    errors = [
        _fit_errors(
            np.concatenate([motion_part[:, rows], *(speed_hats[:, rows] * c[rows + late + shift] for c in currents)]).T,
            target,
        )[0]
        for shift in shifts
    ]
    return _as_delay(shifts / RATE_HZ, np.array(errors), CURRENT_FACTOR, CURRENT_FLOOR)


def is_constant(current: F) -> bool:
    """Return whether a current hardly changes."""
    return bool(current.std() <= SAME_CURRENT * max(abs(float(current.mean())), 1e-3))


def _force_features(motion: Motion) -> F:
    """Return features (k, n): a map of speed and current, also behind lags, and the position."""
    hats, factors = _hats(motion.speed, KNOTS), [np.ones(len(motion))]
    if not is_constant(motion.current):
        n = _normalize(motion.current)
        factors += [n, n**2, *(_lag(n, lag) for lag in VALVE_LAGS_S[1:])]
    base = np.concatenate([hats * factor for factor in factors])
    return np.concatenate([*(_lag(base, lag) for lag in LAGS_S), _normalize(motion.position)[None]])


def _motion_features(motion: Motion) -> tuple[F, F]:
    """Return the features of the motion alone (k, n), and the map of the speed (j, n) that currents multiply."""
    hats = _hats(motion.speed, CURRENT_KNOTS)
    return np.concatenate([hats, _lag(hats, LAGS_S[1]), _normalize(motion.position)[None]]), hats


def _currents(current: F) -> list[F]:
    n = _normalize(current)
    return [*(_lag(n, lag) for lag in VALVE_LAGS_S), n**2, _lag(n**2, VALVE_LAGS_S[1])]


def _hats(values: F, quantiles: tuple[float, ...]) -> F:
    """Return piecewise linear functions (k, n) with knots at the quantiles; they sum to one."""
    knots = np.unique(np.quantile(values, quantiles))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def _lag(values: F, seconds: float) -> F:
    if seconds == 0.0:
        return values
    keep = float(np.exp(-1.0 / (RATE_HZ * seconds)))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=-1))


def _normalize(values: F) -> F:
    return np.asarray((values - values.mean()) / max(float(values.std()), 1e-30))


def _rows(count: int, margin: int, most: int) -> I:
    """Return at most `most` ticks, evenly spread, that stay inside when shifted by `margin`."""
    inside = np.arange(margin + round(0.05 * RATE_HZ), count - margin)
    return inside if len(inside) <= most else inside[np.linspace(0, len(inside) - 1, most).astype(np.int64)]


def _fit_errors(features: F, targets: F) -> F:
    """Return the relative error (m,) of the least-squares fit of each column of `targets` (n, m)."""
    a, y = features - features.mean(axis=0), targets - targets.mean(axis=0)
    gram = a.T @ a
    damped = gram + RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    right = a.T @ y
    weights = np.linalg.solve(damped, right)
    energy = np.maximum((y**2).sum(axis=0), 1e-30)
    rest = energy - 2.0 * (weights * right).sum(axis=0) + (weights * (gram @ weights)).sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(rest, 0.0) / energy))


def _as_delay(shifts_s: F, errors: F, factor: float, floor: float) -> DelayEstimate | None:
    best = int(np.argmin(errors))
    if errors[best] > MAX_ERROR:
        return None
    limit = max(factor * float(errors[best]), float(np.hypot(errors[best], floor)))
    low, high = (_crossing(shifts_s, errors, limit, best, step) for step in (-1, 1))
    at_zero = float(errors[len(errors) // 2])
    return DelayEstimate(_vertex(shifts_s, errors, best), low, high, at_zero, float(errors[best]))


def _crossing(shifts_s: F, errors: F, limit: float, best: int, step: int) -> float:
    """Return the outermost shift on one side of the best whose error is within the limit, interpolated."""
    side = np.arange(best, len(errors) if step > 0 else -1, step)
    last = int(side[np.flatnonzero(errors[side] <= limit)[-1]])
    beyond = last + step
    if not 0 <= beyond < len(errors):
        return float(shifts_s[last])
    share = (limit - errors[last]) / (errors[beyond] - errors[last])
    return float(shifts_s[last] + share * (shifts_s[beyond] - shifts_s[last]))


def _vertex(shifts_s: F, errors: F, best: int) -> float:
    """Return the shift at the vertex of the parabola through the squared errors beside the best."""
    if best in (0, len(errors) - 1):
        return float(shifts_s[best])
    left, middle, right = errors[best - 1 : best + 2] ** 2
    curvature = left - 2.0 * middle + right
    offset = 0.0 if curvature <= 0.0 else 0.5 * (left - right) / curvature
    return float(shifts_s[best] + offset * (shifts_s[1] - shifts_s[0]))
