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
        peaks = measure_peaks(command_m, interval_s)
        for (name, unit), peak, limit in zip(NAMES.items(), peaks, self.as_tuple(), strict=True):
            if peak > limit * (1.0 + NEAR):
                text = f"{what}: its {name} reaches {peak:.4g} {unit}, the limit is {limit:g} {unit}"
                raise StrokeError(f"{text}; choose a gentler stroke or, if the rig allows it, a wider limit")

    def as_tuple(self) -> tuple[float, float, float]:
        """Return stroke [m], speed [m/s] and acceleration [m/s²]."""
        return self.stroke_m, self.speed_m_s, self.acceleration_m_s2


NAMES = {"stroke": "m", "speed": "m/s", "acceleration": "m/s²"}  # of the limits, with their units


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
    bounds = _bounds(interval_s, limits)
    if all((np.abs(np.diff(wanted_m, order)) <= bound).all() for order, bound in enumerate(bounds)):
        return wanted_m, 0.0
    shrunk = StrokeLimits(*((1.0 - MARGIN) * limit for limit in limits.as_tuple()))
    near = _split(wanted_m, _bounds(interval_s, shrunk))
    command = last_m + _largest_share(last_m, near - last_m, bounds) * (near - last_m)
    moved = np.abs(command - wanted_m)
    return command, float(np.mean(moved > 0.01 * moved.max()))


Bounds = tuple[float, ...]  # of the magnitudes of the command and of its first and second difference


def _bounds(interval_s: float, limits: StrokeLimits) -> Bounds:
    return tuple(limit * interval_s**order for order, limit in enumerate(limits.as_tuple()))


def _largest_share(start: F, move: F, bounds: Bounds) -> float:
    """Return the largest factor up to 1 by which `move` may be added to the allowed `start`."""
    share = 1.0
    for order, bound in enumerate(bounds):
        at, change = np.diff(start, order), np.diff(move, order)
        room = np.where(change > 0.0, bound - at, at + bound)
        active = np.abs(change) > 0.0
        share = min(share, float((np.maximum(room, 0.0)[active] / np.abs(change)[active]).min(initial=1.0)))
    return share


def _split(wanted: F, bounds: Bounds) -> F:
    """Return argmin |u - wanted|² within the bounds, by over-relaxed ADMM (Boyd et al. 2011, sections 3.4.1 and 5.2).

    The limited differences `z`, scaled to norm 1, and their multipliers are lists over the orders; each order has its
    own weight, adapted to balance both residuals.
    """
    rooms = [scale * bound for scale, bound in zip(SCALES, bounds, strict=True)]
    command, weights = wanted, list(WEIGHTS)
    z = [np.clip(row, -room, room) for row, room in zip(_rows(wanted), rooms, strict=True)]
    multipliers = [np.zeros_like(part) for part in z]
    factor = _factorise(len(wanted), weights)
    for n in range(1, PASSES + 1):
        right = wanted.copy()
        for k, weight in enumerate(weights):
            right += SCALES[k] * _transpose(weight * z[k] - multipliers[k], k)
        command = np.asarray(cho_solve_banded((factor, True), right))
        rows, last, z = _rows(command), z, list(z)
        for k, row in enumerate(rows):
            mixed = RELAXATION * row + (1.0 - RELAXATION) * last[k]
            z[k] = np.clip(mixed + multipliers[k] / weights[k], -rooms[k], rooms[k])
            multipliers[k] += weights[k] * (mixed - z[k])
        if n % CHECK_EVERY:
            continue
        residuals = [_residuals(rows[k], z[k], weights[k] * (z[k] - last[k]), multipliers[k], k) for k in range(len(z))]
        for k, (primal, dual) in enumerate(residuals):
            if primal > 0.0 and dual > 0.0:
                change = min(max((primal / dual) ** 0.5, 0.1), 10.0)
                weights[k] = max(weights[k] * (change if not 1 / 3 < change < 3.0 else 1.0), MIN_WEIGHT)
        factor = _factorise(len(wanted), weights)
        if max(map(max, residuals)) < RESIDUAL:
            break
    return command


def _residuals(row: F, z: F, moved: F, multiplier: F, order: int) -> tuple[float, float]:
    """Return by how much an order's differences miss their copies `z`, and by how much these still move; relative."""
    if not multiplier.any():
        return 0.0, 0.0
    dual = np.linalg.norm(_transpose(moved, order)) / np.linalg.norm(_transpose(multiplier, order))
    return float(np.linalg.norm(row - z) / np.linalg.norm(row)), float(dual)


def _rows(command: F) -> list[F]:
    return [scale * np.diff(command, k) for k, scale in enumerate(SCALES)]


def _factorise(n: int, weights: Sequence[float]) -> F:
    """Return the banded Cholesky factor of I + sum of w s² D'D, lower form (3, n)."""
    band = np.zeros((3, n))
    band[0] = 1.0
    for k, (s, w) in enumerate(zip(SCALES, weights, strict=True)):
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
