"""Simulations that a user would have and that lack an effect on purpose, for `real_gaps.py`.

A brake without play and a damper without lag are fitted to those parts of a measured recording where the missing effect
has hardly any influence. UTFSM's damper is a function of speed and current without memory, so what happens at a
reversal (friction, elasticity, play) is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from ces_data.recording import Recording

F = NDArray[np.float64]

SETTLED_S = 0.04  # [s] after which a damper has responded to its voltage
KNOTS_M_S = np.array([-0.5, -0.25, -0.12, -0.05, -0.02, 0.0, 0.02, 0.05, 0.12, 0.25, 0.5])
LEVELS = 2  # voltages of the map
SPEED_HZ = 80.0  # [Hz] low-pass of the position before it is differentiated
AWAY = 0.4  # of the stroke: at this distance from its ends a brake slides at its limit
TURN = 0.9  # of the limit: below, the brake unloads its elastic part
MAP_SPEED_HZ = 40.0  # the same for UTFSM's damper
SLIDES = 0.3  # of the highest speed: above, a damper has left its friction loop
SHARPNESS_S_M = 200.0  # of Bingham's step in tanh(s * v): 5 mm/s
MAP_KNOTS_M_S = (-0.12, -0.06, -0.03, -0.015, -0.006, 0.0, 0.006, 0.015, 0.03, 0.06, 0.12)


@dataclass(frozen=True)
class BandBrake:
    """A spring of `stiffness_N_m` in series with a slider of limits `push_N` and `pull_N` (Prandtl), and free play."""

    push_N: float
    pull_N: float
    stiffness_N_m: float
    play_m: float = 0.0

    def __call__(self, time_s: F, position_m: F, current_A: F) -> F:
        """Return the force [N] (n,) at positions [m] (n,)."""
        half = 0.5 * self.play_m
        low, high = -self.pull_N / self.stiffness_N_m - half, self.push_N / self.stiffness_N_m + half
        strain = stop_operator(position_m, 1.0, low, high)
        return np.asarray(self.stiffness_N_m * (strain - np.clip(strain, -half, half)))

    @classmethod
    def fit(cls, recording: Recording) -> BandBrake:
        """Return the brake with the limits of full sliding and the stiffness of unloading, both unaffected by play."""
        position, force = recording.channel("position").values, recording.channel("force").values
        smooth = low_pass(position, 20.0, rate_of(recording))
        speed = np.gradient(smooth)
        sliding = np.abs(smooth - smooth.mean()) < 0.5 * AWAY * float(np.ptp(smooth))
        moves = np.abs(speed) > 0.3 * np.abs(speed).max()
        push = float(np.median(force[sliding & moves & (speed > 0.0)]))
        pull = -float(np.median(force[sliding & moves & (speed < 0.0)]))
        return cls(push, pull, _unloading_stiffness(smooth, force, push, pull))


@njit(cache=True)
def stop_operator(position: F, stiffness: float, low: float, high: float) -> F:
    """Return the force (n,) of a spring with a slider, starting at rest (a stop operator)."""
    out = np.zeros_like(position)
    for k in range(1, len(position)):
        out[k] = min(max(out[k - 1] + stiffness * (position[k] - position[k - 1]), low), high)
    return out


def _unloading_stiffness(position: F, force: F, push: float, pull: float) -> float:
    """Return the median stiffness [N/m] from each reversal to zero force."""
    found = []
    speed = np.gradient(position)
    for turn in np.flatnonzero(np.diff(np.sign(speed)) != 0.0):
        sign = np.sign(force[turn])
        if abs(force[turn]) < TURN * (push if sign > 0.0 else pull):
            continue
        gone = np.flatnonzero(sign * force[turn:] <= 0.05 * abs(force[turn]))
        if len(gone) and abs(position[turn] - position[turn + gone[0]]) > 1e-4:
            found.append(0.95 * force[turn] / (position[turn] - position[turn + gone[0]]))
    return float(np.median(found))


@dataclass(frozen=True)
class StaticMap:
    """Force [N] over speed [m/s] and voltage: `table` (speeds, 2) at the knots and at `low_V` and `high_V`."""

    knots: tuple[float, ...]
    low_V: float
    high_V: float
    table: tuple[tuple[float, ...], ...]

    def __call__(self, time_s: F, position_m: F, current_A: F) -> F:
        """Return the force [N] (n,) at positions [m] and voltages [V] (n,)."""
        return np.asarray(
            self._features(speed_of(time_s, position_m, SPEED_HZ), current_A) @ np.array(self.table).ravel()
        )

    def _features(self, speed: F, voltage: F) -> F:
        share = np.clip((voltage - self.low_V) / (self.high_V - self.low_V), 0.0, 1.0)
        sides = np.stack([1.0 - share, share], axis=1)
        return np.asarray((hats_over(speed, self.knots)[:, :, None] * sides[:, None, :]).reshape(len(speed), -1))

    @classmethod
    def fit(cls, recording: Recording, settled_s: float = SETTLED_S) -> StaticMap:
        """Return the map of the recording where the voltage has not changed for `settled_s`."""
        position, voltage = recording.channel("position").values, recording.channel("current").values
        force, rate = recording.channel("force").values, rate_of(recording)
        low, high = (float(v) for v in np.percentile(voltage, (5.0, 95.0)))
        blank = cls(tuple(KNOTS_M_S.tolist()), low, high, ((0.0,) * LEVELS,) * len(KNOTS_M_S))
        speed = np.gradient(low_pass(position, SPEED_HZ, rate)) * rate
        steady = find_settled(voltage, round(settled_s * rate), 0.1 * (high - low))
        features = blank._features(speed[steady], voltage[steady])
        table = np.linalg.lstsq(features, force[steady], rcond=1e-6)[0].reshape(-1, LEVELS)
        return cls(blank.knots, low, high, tuple(tuple(row) for row in table.tolist()))


@njit(cache=True)
def find_settled(voltage: F, ticks: int, step: float) -> NDArray[np.bool_]:
    """Return where (n,) the voltage has varied by less than `step` over the last `ticks`."""
    since, out = 0, np.zeros(len(voltage), np.bool_)
    for k in range(1, len(voltage)):
        since = k if abs(voltage[k] - voltage[k - 1]) > 0.2 * step or abs(voltage[k] - voltage[since]) > step else since
        out[k] = k - since >= ticks
    return out


def low_pass(values: F, corner_Hz: float, rate_Hz: float) -> F:
    """Return values (n,) after a zero-phase fourth-order low-pass."""
    return np.asarray(sosfiltfilt(butter(2, min(corner_Hz, 0.4 * rate_Hz), fs=rate_Hz, output="sos"), values))


def rate_of(recording: Recording) -> float:
    """Return the rate [Hz] of the position."""
    return 1e9 / float(np.median(np.diff(recording.channel("position").stamps_ns)))


def speed_of(time_s: F, position_m: F, corner_Hz: float = MAP_SPEED_HZ) -> F:
    """Return the speed [m/s] (n,) of the smooth position."""
    return np.gradient(low_pass(position_m, corner_Hz, 1.0 / float(np.median(np.diff(time_s)))), time_s)


def columns_of(recording: Recording) -> tuple[F, F, F]:
    """Return speed [m/s], current [A] and force [N], each (n,), at the ticks of the position."""
    position, current, force = (recording.channel(n) for n in ("position", "current", "force"))
    ticks = 1e-9 * (position.stamps_ns - position.stamps_ns[0])
    speed = np.gradient(low_pass(position.values, MAP_SPEED_HZ, rate_of(recording)), ticks)
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
        powers = np.stack([np.ones_like(speed), speed, speed**3], axis=1)
        return cls(*np.linalg.lstsq(powers, force, rcond=None)[0].tolist())

    @classmethod
    def fit_sliding(cls, recording: Recording, friction: bool) -> SpeedPolynomial:
        """Return the damper fitted where it slides, with its linear viscous part; `friction` decides on the step."""
        speed, _, force = columns_of(recording)
        slides = np.abs(speed) > SLIDES * np.abs(speed).max()
        features = np.stack([np.ones_like(speed), speed, np.sign(speed)], axis=1)
        offset, linear, step = np.linalg.lstsq(features[slides], force[slides], rcond=None)[0].tolist()
        return cls(offset, linear, 0.0, step if friction else 0.0)


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
    """Force [N] over speed and current: `table` (speeds, currents) at MAP_KNOTS_M_S and `currents`, linear between."""

    currents: tuple[float, ...]
    table: tuple[tuple[float, ...], ...]

    def __call__(self, time_s: F, position_m: F, current_A: F) -> F:
        """Return the force [N] (n,) at positions [m] and currents [A] (n,)."""
        return self._features(speed_of(time_s, position_m), current_A) @ np.array(self.table).ravel()

    def _features(self, speed: F, current: F) -> F:
        product = hats_over(speed, MAP_KNOTS_M_S)[:, :, None] * hats_over(current, self.currents)[:, None, :]
        return np.asarray(product.reshape(len(speed), -1))

    @classmethod
    def fit(cls, recordings: Sequence[Recording]) -> CurrentMap:
        """Return the least-squares map of all ticks, with a column for each recording's current."""
        speed, current, force = (np.concatenate(c) for c in zip(*map(columns_of, recordings), strict=True))
        currents = tuple(sorted({round(float(i), 3) for i in current}))
        blank = cls(currents, ((0.0,) * len(currents),) * len(MAP_KNOTS_M_S))
        table = np.linalg.lstsq(blank._features(speed, current), force, rcond=1e-6)[0].reshape(-1, len(currents))
        return cls(currents, tuple(tuple(row) for row in table.tolist()))


def hats_over(values: F, knots: Sequence[float]) -> F:
    """Return the weights (n, knots) of linear interpolation, constant outside the knots."""
    place = np.interp(values, knots, np.arange(len(knots)))
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(len(knots)))))
