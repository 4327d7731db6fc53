"""Simulations of UTFSM's damper that a user would have, for `real_gaps.py`: force as a function of speed and current.

None has memory, so what happens at a reversal (friction, elasticity, play) is missing from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.gaps.simulations import low_pass, rate_of
from ces_identify.recordings.recording import Recording

F = NDArray[np.float64]

SPEED_HZ = 40.0  # [Hz] low-pass of the position before it is differentiated
SLIDES = 0.3  # of the highest speed: above, a damper has left its friction loop
SHARPNESS_S_M = 200.0  # of Bingham's step in tanh(s * v): 5 mm/s
KNOTS_M_S = (-0.12, -0.06, -0.03, -0.015, -0.006, 0.0, 0.006, 0.015, 0.03, 0.06, 0.12)


def speed_of(time_s: F, position_m: F) -> F:
    """Return the speed [m/s] (n,) of the smooth position."""
    return np.gradient(low_pass(position_m, SPEED_HZ, 1.0 / float(np.median(np.diff(time_s)))), time_s)


def columns_of(recording: Recording) -> tuple[F, F, F]:
    """Return speed [m/s], current [A] and force [N], each (n,), at the ticks of the position."""
    position, current, force = (recording.channel(n) for n in ("position", "current", "force"))
    ticks = 1e-9 * (position.stamps_ns - position.stamps_ns[0])
    speed = np.gradient(low_pass(position.values, SPEED_HZ, rate_of(recording)), ticks)
    others = (np.interp(position.stamps_ns, c.stamps_ns, c.values) for c in (current, force))
    return (speed, *others)  # type: ignore[return-value]


@dataclass(frozen=True)
class SpeedPolynomial:
    """F = offset + linear v + cubic v^3 + friction tanh(s v): a damper at one current."""

    offset_N: float
    linear_Ns_m: float
    cubic_Ns3_m3: float
    friction_N: float = 0.0

    def __call__(self, time_s: F, position_m: F, current_A: F) -> F:
        """Return the force [N] (n,) at positions [m] (n,)."""
        v = speed_of(time_s, position_m)
        smooth = self.offset_N + self.linear_Ns_m * v + self.cubic_Ns3_m3 * v**3
        return smooth + self.friction_N * np.tanh(SHARPNESS_S_M * v)

    @classmethod
    def fit(cls, recording: Recording) -> SpeedPolynomial:
        """Return the least-squares polynomial of all ticks."""
        speed, _, force = columns_of(recording)
        return cls(*np.linalg.lstsq(_powers(speed), force, rcond=None)[0].tolist())

    @classmethod
    def fit_sliding(cls, recording: Recording, friction: bool) -> SpeedPolynomial:
        """Return the damper fitted where it slides, with its linear viscous part; `friction` decides on the step."""
        speed, _, force = columns_of(recording)
        slides = np.abs(speed) > SLIDES * np.abs(speed).max()
        features = np.stack([np.ones_like(speed), speed, np.sign(speed)], axis=1)
        offset, linear, step = np.linalg.lstsq(features[slides], force[slides], rcond=None)[0].tolist()
        return cls(offset, linear, 0.0, step if friction else 0.0)


def _powers(speed: F) -> F:
    return np.stack([np.ones_like(speed), speed, speed**3], axis=1)


@dataclass(frozen=True)
class Bingham:
    """F = offset + c(i) v + y(i) tanh(s v), with c and y quadratic in the current."""

    weights: tuple[float, ...]  # (7,)

    def __call__(self, time_s: F, position_m: F, current_A: F) -> F:
        """Return the force [N] (n,) at positions [m] and currents [A] (n,)."""
        return self._features(speed_of(time_s, position_m), current_A) @ np.array(self.weights)

    @staticmethod
    def _features(speed: F, current: F) -> F:
        step = np.tanh(SHARPNESS_S_M * speed)
        powers = [current**k for k in range(3)]
        return np.stack([np.ones_like(speed), *(p * speed for p in powers), *(p * step for p in powers)], axis=1)

    @classmethod
    def fit(cls, recordings: Sequence[Recording]) -> Bingham:
        """Return the least-squares model of all ticks."""
        speed, current, force = (np.concatenate(c) for c in zip(*map(columns_of, recordings), strict=True))
        return cls(tuple(np.linalg.lstsq(cls._features(speed, current), force, rcond=None)[0].tolist()))


@dataclass(frozen=True)
class CurrentMap:
    """Force [N] over speed and current: `table` (speeds, currents) at KNOTS_M_S and `currents`, linear in between."""

    currents: tuple[float, ...]
    table: tuple[tuple[float, ...], ...]

    def __call__(self, time_s: F, position_m: F, current_A: F) -> F:
        """Return the force [N] (n,) at positions [m] and currents [A] (n,)."""
        return self._features(speed_of(time_s, position_m), current_A) @ np.array(self.table).ravel()

    def _features(self, speed: F, current: F) -> F:
        product = _hats(speed, KNOTS_M_S)[:, :, None] * _hats(current, self.currents)[:, None, :]
        return np.asarray(product.reshape(len(speed), -1))

    @classmethod
    def fit(cls, recordings: Sequence[Recording]) -> CurrentMap:
        """Return the least-squares map of all ticks, with a column for each recording's current."""
        speed, current, force = (np.concatenate(c) for c in zip(*map(columns_of, recordings), strict=True))
        currents = tuple(sorted({round(float(i), 3) for i in current}))
        blank = cls(currents, ((0.0,) * len(currents),) * len(KNOTS_M_S))
        table = np.linalg.lstsq(blank._features(speed, current), force, rcond=1e-6)[0].reshape(-1, len(currents))
        return cls(currents, tuple(tuple(row) for row in table.tolist()))


def _hats(values: F, knots: Sequence[float]) -> F:
    """Return the weights (n, knots) of linear interpolation, constant outside the knots."""
    place = np.interp(values, knots, np.arange(len(knots)))
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(len(knots)))))
