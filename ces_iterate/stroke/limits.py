"""Limits of a command, and the projection that keeps them: any command goes in, the nearest allowed one comes out.

Stroke, speed and acceleration of a sampled command are its values and its first and second differences. All their
bounds are linear, so the allowed commands are a convex set: projecting onto it never enlarges the distance between two
commands, and a contraction stays one (Boyd, Vandenberghe 2004, section 8.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from ces_data.arrays import F
from ces_iterate.errors import StrokeError
from ces_observer.fields import quantity

MARGIN = 2e-3  # share of each limit kept free for the inexactness of the projection
PASSES, CHECK_EVERY, RESIDUAL = 2000, 25, 1e-4  # of the projection's splitting; relative residual at which it ends
SCALES = (1.0, 0.5, 0.25)  # of the differences of order 0, 1 and 2: norm 1
WEIGHTS, MIN_WEIGHT, RELAXATION = (10.0, 200.0, 2000.0), 1e-3, 1.6
NEAR = 1e-9  # relative rounding of a peak


@dataclass(frozen=True)
class StrokeLimits:
    """What a command may do: position either side of mid-stroke, speed, acceleration."""

    stroke_m: float = quantity(0.050, "m", "largest distance of the command from mid-stroke", 1e-4, 0.5)
    speed_m_s: float = quantity(1.5, "m/s", "largest speed of the command", 1e-3, 20.0)
    acceleration_m_s2: float = quantity(200.0, "m/s²", "largest acceleration of the command", 0.1, 5e3)

    def require_allowed(self, command_m: F, interval_s: float, what: str) -> None:
        """Raise StrokeError naming the first limit that `command_m` (n,) breaks; `what` begins the message."""
        for name, peak, limit in zip(NAMES, measure_peaks(command_m, interval_s), self.as_tuple(), strict=True):
            if peak > limit * (1.0 + NEAR):
                unit = name.rpartition(" ")[2]
                text = f"{what}: its {name.partition(' ')[0]} reaches {peak:.4g} {unit}, the limit is {limit:g} {unit}"
                raise StrokeError(f"{text}; choose a gentler stroke or, if the rig allows it, a wider limit")

    def as_tuple(self) -> tuple[float, float, float]:
        """Return stroke [m], speed [m/s] and acceleration [m/s²]."""
        return self.stroke_m, self.speed_m_s, self.acceleration_m_s2


NAMES = ("stroke m", "speed m/s", "acceleration m/s²")


def measure_peaks(command_m: F, interval_s: float) -> tuple[float, float, float]:
    """Return the largest magnitudes of position [m], speed [m/s] and acceleration [m/s²] of a command (n,)."""
    first, second = np.diff(command_m), np.diff(command_m, 2)
    peaks = (np.abs(values).max(initial=0.0) for values in (command_m, first / interval_s, second / interval_s**2))
    return tuple(map(float, peaks))  # type: ignore[return-value]


def project_command(wanted_m: F, last_m: F, interval_s: float, limits: StrokeLimits) -> tuple[F, float]:
    """Return the allowed command (n,) nearest to `wanted_m`, and the share of it that was changed.

    `last_m` must be allowed. The nearest command is found by operator splitting (ADMM) to within MARGIN of the limits;
    a blend with `last_m` then keeps them exactly, because the allowed commands are convex. The share is that of the
    samples moved by more than 1 % of the largest move.
    """
    bounds = _bounds(len(last_m), interval_s, limits)
    if _inside(wanted_m, bounds):
        return wanted_m, 0.0
    near = _split(wanted_m, _bounds(len(last_m), interval_s, _shrink(limits, 1.0 - MARGIN)))
    command = last_m + _largest_share(last_m, near - last_m, bounds) * (near - last_m)
    moved = np.abs(command - wanted_m)
    return command, float(np.mean(moved > 0.01 * moved.max()))


Bounds = tuple[tuple[F, F], ...]  # of the command and of its first and second difference: low and high


def _bounds(n: int, interval_s: float, limits: StrokeLimits) -> Bounds:
    sizes = (limit * interval_s**order for order, limit in enumerate(limits.as_tuple()))
    rooms = [np.full(n - order, size) for order, size in enumerate(sizes)]
    return tuple((-room, room) for room in rooms)


def _shrink(limits: StrokeLimits, factor: float) -> StrokeLimits:
    return StrokeLimits(*(factor * limit for limit in limits.as_tuple()))


def _inside(command_m: F, bounds: Bounds) -> bool:
    rows = (command_m, np.diff(command_m), np.diff(command_m, 2))
    return all(bool(((low <= r) & (r <= high)).all()) for r, (low, high) in zip(rows, bounds, strict=True))


def _largest_share(start: F, move: F, bounds: Bounds) -> float:
    """Return the largest factor up to 1 by which `move` may be added to the allowed `start`."""
    share = 1.0
    for order, (low, high) in enumerate(bounds):
        at, change = np.diff(start, order), np.diff(move, order)
        room = np.where(change > 0.0, high - at, at - low)
        active = np.abs(change) > 0.0
        share = min(share, float((np.maximum(room, 0.0)[active] / np.abs(change)[active]).min(initial=1.0)))
    return share


def _split(wanted: F, bounds: Bounds) -> F:
    """Return argmin |u - wanted|² within the bounds, by ADMM (Boyd et al. 2011, sections 3.4.1 and 5.2)."""
    splitting = _Splitting(wanted, bounds)
    for n in range(1, PASSES + 1):
        splitting.step()
        if n % CHECK_EVERY == 0 and splitting.rebalance():
            break
    return splitting.command


class _Splitting:
    """The state of the ADMM: the command, its limited differences `z`, and their multipliers.

    The differences are scaled to norm 1; each order has its own weight, adapted to balance both residuals.
    """

    def __init__(self, wanted: F, bounds: Bounds) -> None:
        self._wanted = self.command = wanted
        self._bounds = [(scale * low, scale * high) for scale, (low, high) in zip(SCALES, bounds, strict=True)]
        self._weights = list(WEIGHTS)
        self._z = [np.clip(row, *limits) for row, limits in zip(_rows(wanted), self._bounds, strict=True)]
        self._last = self._z
        self._multipliers = [np.zeros_like(part) for part in self._z]
        self._factor = _factorise(len(wanted), SCALES, self._weights)

    def step(self) -> None:
        """Minimise for the command, project the differences, update the multipliers; over-relaxed."""
        right = self._wanted.copy()
        for k, weight in enumerate(self._weights):
            right += SCALES[k] * _transpose(weight * self._z[k] - self._multipliers[k], k)
        self.command = np.asarray(cho_solve_banded((self._factor, True), right))
        self._last, self._z = self._z, list(self._z)
        for k, row in enumerate(_rows(self.command)):
            mixed = RELAXATION * row + (1.0 - RELAXATION) * self._last[k]
            self._z[k] = np.clip(mixed + self._multipliers[k] / self._weights[k], *self._bounds[k])
            self._multipliers[k] += self._weights[k] * (mixed - self._z[k])

    def rebalance(self) -> bool:
        """Adapt the weights; return whether both residuals of all orders are small."""
        residuals = [self._residuals(k, row) for k, row in enumerate(_rows(self.command))]
        for k, (primal, dual) in enumerate(residuals):
            if primal > 0.0 and dual > 0.0:
                change = min(max((primal / dual) ** 0.5, 0.1), 10.0)
                self._weights[k] = max(self._weights[k] * (change if not 1 / 3 < change < 3.0 else 1.0), MIN_WEIGHT)
        self._factor = _factorise(len(self._wanted), SCALES, self._weights)
        return max(map(max, residuals)) < RESIDUAL

    def _residuals(self, k: int, row: F) -> tuple[float, float]:
        """Return by how much the order's differences miss their copies, and by how much these still move; relative."""
        if not self._multipliers[k].any():
            return 0.0, 0.0
        primal = np.linalg.norm(row - self._z[k]) / np.linalg.norm(row)
        moved = np.linalg.norm(_transpose(self._weights[k] * (self._z[k] - self._last[k]), k))
        return float(primal), float(moved / np.linalg.norm(_transpose(self._multipliers[k], k)))


def _rows(command: F) -> list[F]:
    return [scale * np.diff(command, k) for k, scale in enumerate(SCALES)]


def _factorise(n: int, scale: Sequence[float], weights: Sequence[float]) -> F:
    """Return the banded Cholesky factor of I + sum of w s² D'D, lower form (3, n)."""
    band = np.zeros((3, n))
    band[0] = 1.0
    for k, (s, w) in enumerate(zip(scale, weights, strict=True)):
        stencil = np.array(([1.0], [-1.0, 1.0], [1.0, -2.0, 1.0])[k])
        for i, a in enumerate(stencil):
            for j, b in enumerate(stencil[: i + 1]):
                band[i - j, j : n - k + j] += w * s * s * a * b
    return np.asarray(cholesky_banded(band, lower=True))


def _transpose(part: F, order: int) -> F:
    """Return the transpose of the `order`-th difference applied to `part`."""
    for _ in range(order):
        part = -np.diff(part, prepend=0.0, append=0.0)
    return part
