"""Delays between channels, estimated with an interval: how late force or current are logged relative to the position.

A damper's force depends on motion and current until now, never on those to come. For every shift of a channel, a
flexible causal map of position, speed and current, with memory, is fitted to the force by least squares; it contains
the lags that dampers have. The relative error of the fit is least at the right shift. All shifts that fit almost as
well form the interval: where a lag of the damper or of its valve could imitate the delay, as with a single sine, the
interval is wide and holds zero.

Recordings of one damper by one logger may be joined: sines at several frequencies show together what none shows alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.numerics.arrays import F, I
from ces_identify.sense.force_map import (
    LAGS_S,
    VALVE_LAGS_S,
    fit_errors,
    force_features,
    hats,
    is_constant,
    lag,
    normalize,
)
from ces_identify.sense.motion import RATE_HZ, Motion

MAX_DELAY_S = 0.07
FAR_S = 0.5  # searched if no shift within MAX_DELAY_S fits, or one at its end fits best: loggers that started apart
MIN_TICKS = 2000
ROWS, CURRENT_ROWS = 8000, 5000  # of the regressions
CURRENT_KNOTS = (0.0, 0.03, 0.2, 0.4, 0.6, 0.8, 0.97, 1.0)
CURRENT_STEP = 2  # ticks between shifts of the current
FACTOR, FLOOR = 1.35, 0.02  # error that still counts as a fit: a multiple of the least, and never below the floor
CURRENT_FACTOR, CURRENT_FLOOR = 1.12, 0.025
LIKELY_S, LIKELY_FACTOR, LIKELY_FLOOR, LIKELY_ERROR = 0.015, 1.15, 0.01, 0.2  # of a delay that is probable only
LIKELY_WIDTH_S = 0.05  # of the interval
MAX_ERROR = 0.6  # of the best fit; beyond it the force is not that of these signals


@dataclass(frozen=True)
class DelayEstimate:
    """How late a signal is logged [s], with the interval of the shifts that fit; `errors` at zero and at the best.

    Shifts of up to `reach_s` were tried.
    """

    late_s: float
    low_s: float
    high_s: float
    error_at_zero: float
    least_error: float
    reach_s: float = MAX_DELAY_S

    @property
    def certain(self) -> bool:
        """Whether the interval does not hold zero."""
        return self.low_s > 0.0 or self.high_s < 0.0

    @property
    def likely(self) -> bool:
        """Whether a delay beyond the lags of dampers fits clearly better than none; none cannot be excluded."""
        limit = max(LIKELY_FACTOR * self.least_error, float(np.hypot(self.least_error, LIKELY_FLOOR)))
        narrow = self.high_s - self.low_s < LIKELY_WIDTH_S  # a single fast sine fits at any phase
        return narrow and abs(self.late_s) > LIKELY_S and self.least_error < LIKELY_ERROR and self.error_at_zero > limit

    @property
    def open_ended(self) -> bool:
        """Whether the largest shift that was tried fits, too, so that the delay may be larger."""
        return max(-self.low_s, self.high_s) >= self.reach_s - 1.0 / RATE_HZ

    @property
    def beyond(self) -> bool:
        """Whether the largest shift that was tried fits best: the delay is at least that of the interval's near end."""
        return abs(self.late_s) >= self.reach_s - 1.0 / RATE_HZ

    @property
    def settled(self) -> bool:
        """Whether it fits well without a delay, so that there is no reason to try larger ones."""
        return not self.open_ended and not self.certain and self.least_error < LIKELY_ERROR

    @property
    def nearest_s(self) -> float:
        """The end of the interval that is nearer to zero, 0 if zero is inside."""
        return min((self.low_s, self.high_s), key=abs) if self.certain else 0.0


def force_delay(motion: Motion, far: bool = True) -> DelayEstimate | None:
    """Return how late the force is logged relative to the position, None if that cannot be known.

    With `far`, also a delay of more than MAX_DELAY_S if none up to that fits.
    """
    if len(motion) < MIN_TICKS or motion.speed.std() == 0.0 or motion.force.std() == 0.0:
        return None
    near = _force_delay_within(motion, MAX_DELAY_S)
    if not far or (near is not None and near.settled):
        return near
    wide = _force_delay_within(motion, FAR_S)
    if wide is None or wide.open_ended or wide.least_error > LIKELY_ERROR or abs(wide.late_s) <= MAX_DELAY_S:
        return near
    return wide if near is None or FACTOR * wide.least_error < near.least_error else near


def _force_delay_within(motion: Motion, reach_s: float) -> DelayEstimate | None:
    """Return the delay if one of up to `reach_s` fits, and the parts of the motion are long enough for such shifts."""
    features, reach = force_features(motion), round(reach_s * RATE_HZ)
    rows = _rows(motion, reach, ROWS)
    if len(rows) < MIN_TICKS // 2:
        return None
    shifts = np.arange(-reach, reach + 1)
    targets = np.stack([motion.force[rows + shift] for shift in shifts], axis=1)
    errors = fit_errors(features[:, rows].T, targets)
    return _as_delay(shifts / RATE_HZ, errors, FACTOR, FLOOR)


def current_delay(motion: Motion, force_late_s: float = 0.0) -> DelayEstimate | None:
    """Return how late the current is logged relative to the force, None if that cannot be known.

    `force_late_s` is the delay of the force relative to the position, which is taken out first.
    """
    if len(motion) < MIN_TICKS or is_constant(motion.current) or motion.speed.std() == 0.0:
        return None
    reach, late = round(MAX_DELAY_S * RATE_HZ), round(force_late_s * RATE_HZ)
    rows = _rows(motion, reach + abs(late), CURRENT_ROWS)
    motion_part, speed_hats = _motion_features(motion)
    currents = _currents(motion.current)
    shifts = np.arange(-reach, reach + 1, CURRENT_STEP)
    target = motion.force[rows + late][:, None]
    errors = [
        fit_errors(
            np.concatenate([motion_part[:, rows], *(speed_hats[:, rows] * c[rows + late + shift] for c in currents)]).T,
            target,
        )[0]
        for shift in shifts
    ]
    return _as_delay(shifts / RATE_HZ, np.array(errors), CURRENT_FACTOR, CURRENT_FLOOR)


def _motion_features(motion: Motion) -> tuple[F, F]:
    """Return the features of the motion alone (k, n), and the map of the speed (j, n) that currents multiply."""
    speeds = hats(motion.speed, CURRENT_KNOTS)
    return np.concatenate([speeds, lag(speeds, LAGS_S[1]), normalize(motion.position)[None]]), speeds


def _currents(current: F) -> list[F]:
    n = normalize(current)
    return [*(lag(n, seconds) for seconds in VALVE_LAGS_S), n**2, lag(n**2, VALVE_LAGS_S[1])]


def _rows(motion: Motion, margin: int, most: int) -> I:
    """Return at most `most` ticks, evenly spread, that stay inside when shifted by `margin`."""
    inside = motion.inner_ticks(margin + round(0.05 * RATE_HZ), margin)
    return inside if len(inside) <= most else inside[np.linspace(0, len(inside) - 1, most).astype(np.int64)]


def _as_delay(shifts_s: F, errors: F, factor: float, floor: float) -> DelayEstimate | None:
    best = int(np.argmin(errors))
    if errors[best] > MAX_ERROR:
        return None
    limit = max(factor * float(errors[best]), float(np.hypot(errors[best], floor)))
    low, high = (_crossing(shifts_s, errors, limit, best, step) for step in (-1, 1))
    at_zero = float(errors[len(errors) // 2])
    return DelayEstimate(_vertex(shifts_s, errors, best), low, high, at_zero, float(errors[best]), float(shifts_s[-1]))


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
