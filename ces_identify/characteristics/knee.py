"""The knee of a force-speed curve: where two straight lines that meet describe it much better than one line.

The curve is the mean of both branches of a cycle at SHARES of its peak speed. Each cycle gives a knee of its own, so
that its spread is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ces_identify.characteristics.cycle_values import SHARES, HalfValues
from ces_identify.numerics.arrays import F

MAX_ERROR_RATIO = 0.5  # RMS error of two lines over that of one line, at most
MIN_SLOPE_CHANGE = 1.5  # ratio of the steeper to the flatter slope, at least
CANDIDATES = np.round(np.arange(0.10, 0.81, 0.01), 2)  # shares of the peak speed tried as the knee
RESOLUTION = 0.025 / np.sqrt(3.0)  # standard deviation of a knee between two neighbours of SHARES
MAX_WIDTH = 0.3  # of the force: where the branches differ more, their mean is no curve
MIN_CYCLES = 3


@dataclass(frozen=True)
class KneeFit:
    """A knee at `speed_m_s` (signed) with the standard deviation over the cycles, and the slopes [Ns/m] beside it."""

    speed_m_s: float
    speed_sd_m_s: float
    force_N: float
    slope_below_Ns_m: float
    slope_above_Ns_m: float


def find_knee(half: HalfValues) -> KneeFit | str:
    """Return the knee of one direction, or the reason why there is none."""
    known = np.isfinite(half.mean).all(axis=1)
    if known.sum() < MIN_CYCLES:
        return f"{known.sum()} cycles; {MIN_CYCLES} needed"
    curve, peak = half.mean[known], half.peak_speed[known]
    mean = curve.mean(axis=0)
    one = float(np.sqrt(_errors(np.stack([np.ones_like(SHARES), SHARES], axis=1), mean[None])[0]))
    errors = np.stack([_errors(_design(share), curve) for share in CANDIDATES])
    best = int(np.argmin(np.stack([_errors(_design(share), mean[None])[0] for share in CANDIDATES])))
    level, slope, change = np.linalg.lstsq(_design(CANDIDATES[best]), mean, rcond=None)[0]
    two = float(np.sqrt(_errors(_design(CANDIDATES[best]), mean[None])[0]))
    below, above = float(slope) / float(peak.mean()), float(slope + change) / float(peak.mean())
    if best in (0, len(CANDIDATES) - 1) or two > MAX_ERROR_RATIO * one:
        return "no knee: two lines are not much better than one"
    at = int(np.argmin(np.abs(SHARES - CANDIDATES[best])))
    width = abs(float(half.width[known][:, at].mean()) / float(mean[at]))
    if width > MAX_WIDTH:
        return f"cannot know: at the knee the branches differ by {100.0 * width:.0f} % of the force; move slower"
    if max(abs(below), abs(above)) < MIN_SLOPE_CHANGE * min(abs(below), abs(above)):
        return f"no knee: the slope changes from {below:.0f} to {above:.0f} Ns/m only"
    each = CANDIDATES[np.argmin(errors, axis=0)] * peak
    doubt = float(np.hypot(each.std(ddof=1), RESOLUTION * peak.mean()))
    speed = float(CANDIDATES[best] * peak.mean())
    force = float(level + slope * CANDIDATES[best])
    return KneeFit(speed, doubt, force, below, above)


def _design(share: float) -> F:
    """Return the regressors (shares, 3) of two lines that meet at `share`."""
    return np.stack([np.ones_like(SHARES), SHARES, np.maximum(SHARES - share, 0.0)], axis=1)


def _errors(design: F, curves: F) -> F:
    """Return the mean squared error (n,) of the least-squares fit of each curve (n, shares)."""
    base = np.linalg.qr(design)[0]
    return np.asarray(np.mean((curves - (curves @ base) @ base.T) ** 2, axis=1))
