"""What single cycles say: forces at peak speed, work, force over speed of both branches, forces at zero speed.

Compression is the half with rising position, rebound the other. In each half the speed first rises to its peak (the
accelerating branch) and then falls to zero (the decelerating branch).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ces_identify.characteristics.cycles import HALF, Cycles
from ces_identify.numerics.arrays import F

COMPRESSION, REBOUND = "compression", "rebound"
DIRECTIONS = (COMPRESSION, REBOUND)
PEAK_SHARE = 0.97  # the peak is where the speed is at least this share of the largest
EVEN = 7  # instants of a half over which the speed is averaged to find the peak: 0.2 % lower for a sine
SHARES = np.round(np.arange(1, 20) * 0.05, 2)  # of the peak speed, at which the branches are read
SKEW_S = 1e-3  # [s] delay between force and position whose effect on widths is stated


@dataclass(frozen=True)
class HalfValues:
    """One direction of n cycles, forces as measured.

    `peak_speed` (n,) and `peak_force` (n,) are means over the stretch where the speed is at least PEAK_SHARE of its
    largest; `accelerating` and `decelerating` (n, shares) are the forces at SHARES of the peak speed.
    """

    peak_speed: F
    peak_force: F
    accelerating: F
    decelerating: F

    @property
    def mean(self) -> F:
        """The mean force of both branches (n, shares)."""
        return 0.5 * (self.accelerating + self.decelerating)

    @property
    def width(self) -> F:
        """How much more the decelerating branch resists than the accelerating one (n, shares)."""
        return np.sign(self.peak_speed)[:, None] * (self.decelerating - self.accelerating)


@dataclass(frozen=True)
class CycleValues:
    """Values (n,) of n cycles: `work_J`, the viscous damping of the same work, and the forces at zero speed.

    `top_N` is the force at full compression, `bottom_N` at full rebound; `width_per_skew_N` is how much their
    difference changes if the force is delayed by SKEW_S.
    """

    work_J: F
    damping_Ns_m: F
    power_W: F
    top_N: F
    bottom_N: F
    width_per_skew_N: F
    halves: dict[str, HalfValues]


def evaluate_cycles(cycles: Cycles, source: str) -> CycleValues:
    """Return the values of cycles by the force of one source; NaN for a cycle without it."""
    force, x, v, t = cycles.forces[source], cycles.position, cycles.speed, cycles.time_s
    force = np.where(np.isfinite(force).all(axis=1, keepdims=True), force, np.nan)
    work = _close_loop(force, x)
    period = t[:, -1] - t[:, 0]
    slope = np.gradient(force, axis=1) / np.gradient(t, axis=1)
    bottom_slope = 0.5 * (slope[:, 1] + slope[:, -2])
    return CycleValues(
        work_J=work,
        damping_Ns_m=work / _integrate(v**2, t),
        power_W=work / period,
        top_N=force[:, HALF],
        bottom_N=0.5 * (force[:, 0] + force[:, -1]),
        width_per_skew_N=np.abs(slope[:, HALF] - bottom_slope) * SKEW_S,
        halves={
            COMPRESSION: _evaluate_half(v[:, : HALF + 1], force[:, : HALF + 1], 1.0),
            REBOUND: _evaluate_half(v[:, HALF:], force[:, HALF:], -1.0),
        },
    )


def _close_loop(force: F, x: F) -> F:
    """Return the area (n,) [J] of the loops force over position, each closed by a straight line."""
    inner = np.sum(0.5 * (force[:, 1:] + force[:, :-1]) * np.diff(x, axis=1), axis=1)
    return np.asarray(inner + 0.5 * (force[:, 0] + force[:, -1]) * (x[:, 0] - x[:, -1]))


def _evaluate_half(speed: F, force: F, sign: float) -> HalfValues:
    v = sign * speed
    even = uniform_filter1d(v, EVEN, axis=1, mode="nearest")  # the highest of noisy samples is too high
    top = even >= PEAK_SHARE * even.max(axis=1, keepdims=True)
    count = top.sum(axis=1)
    peak_speed = np.where(top, v, 0.0).sum(axis=1) / count
    peak_force = np.where(top, force, 0.0).sum(axis=1) / count
    middle = np.rint((top * np.arange(v.shape[1])).sum(axis=1) / count).astype(int)
    rising, falling = np.full((2, len(v), len(SHARES)), np.nan)
    for i, m in enumerate(middle):
        wanted = SHARES * peak_speed[i]
        rising[i] = np.interp(wanted, np.maximum.accumulate(v[i, : m + 1]), force[i, : m + 1])
        falling[i] = np.interp(wanted, np.maximum.accumulate(v[i, m:][::-1]), force[i, m:][::-1])
    return HalfValues(sign * peak_speed, np.where(np.isfinite(force).all(axis=1), peak_force, np.nan), rising, falling)


def _integrate(values: F, t: F) -> F:
    """Return the integrals (n,) of values over t by trapezoids (NumPy 1.26 and 2 name theirs differently)."""
    return np.asarray(np.sum(0.5 * (values[:, 1:] + values[:, :-1]) * np.diff(t, axis=1), axis=1))
