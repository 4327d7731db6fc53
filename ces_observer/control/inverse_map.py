"""The inverse of a model: a desired force at a speed goes in, the current that gives it comes out."""

from __future__ import annotations

import json
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import copysign, isfinite

from ces_observer.errors import CesError, ModelError
from ces_observer.limits import InverseLimits
from ces_observer.model import Model
from ces_observer.records import read_record, write_record
from ces_observer.structures.structure import Predictor

SPEEDS = 24  # of the grid, on each side of zero; denser towards zero, where the force is steep
CURRENTS = 17
STEP_S = 0.1
RISE = 0.632
STEP_SPEED_M_S = 0.15  # during a step of current


def compute_inverse_map(model: Model, source: str = "model") -> InverseMap:
    """Return the inverse of the model's steady force over its envelope of speeds and currents.

    Raises ModelError, naming `source`, if the envelope lacks a direction of motion or has only one current.
    """
    slowest, fastest = model.envelope.speed_m_s
    lowest, highest = model.envelope.current_A
    if not slowest < -InverseLimits.MIN_SPEED_M_S < InverseLimits.MIN_SPEED_M_S < fastest:
        raise ModelError(f"{source}: speeds from {slowest:g} to {fastest:g} m/s; a controller needs both directions")
    if not lowest < highest:
        raise ModelError(f"{source}: identified at {lowest:g} A only; identify it on recordings of several currents")
    speeds = (*(-v for v in reversed(_space_speeds(-slowest))), *_space_speeds(fastest))
    currents = tuple(lowest + (highest - lowest) * k / (CURRENTS - 1) for k in range(CURRENTS))
    run = model.make_predictor()
    rows = [[steady_force(model, run, speed, current) for current in currents] for speed in speeds]
    stiffer = sum(copysign(1.0, v) * (row[-1] - row[0]) for v, row in zip(speeds, rows, strict=True))
    monotone = []  # in the valve's overall sense: more current gives more (or less) damping
    for speed, row in zip(speeds, rows, strict=True):
        sense = copysign(1.0, speed * stiffer)
        monotone.append(tuple(sense * force for force in _make_monotone([sense * force for force in row])))
    return InverseMap(speeds, currents, tuple(monotone))


def steady_force(model: Model, run: Predictor, speed_m_s: float, current_A: float) -> float:
    """Return the model's force [N] at mid-stroke at constant speed and current; `run` is used if only a run shows it.

    A force outside the force envelope counts as that envelope's end.
    """
    exact = model.body.steady_force(model.operating_range, speed_m_s, current_A)
    if exact is None:
        return run_to_steady(model, run, speed_m_s, current_A)
    low, high = model.force_envelope_N
    return min(max(exact, low), high)


def run_to_steady(model: Model, run: Predictor, speed_m_s: float, current_A: float) -> float:
    """Return the model's force [N] at mid-stroke after a long approach at constant speed and current.

    The model clamps a stroke beyond its envelope, and holds a force beyond its own.
    """
    rate = model.sampling.rate_Hz
    ticks = round(InverseLimits.SETTLING_S * rate)
    middle = 0.5 * sum(model.envelope.position_m)
    run.reset()
    force = 0.0
    for tick in range(-ticks, 1):
        force = run.tick(middle + speed_m_s * tick / rate, speed_m_s, current_A)
    return force


def current_lag_s(model: Model) -> float:
    """Return the time [s] in which the model's force covers 63 % of a step of current: coil, valve and oil together.

    It is the mean over both directions of motion and steps up and down between 25 % and 75 % of the current envelope.
    """
    lowest, highest = model.envelope.current_A
    low, high = (lowest + share * (highest - lowest) for share in (0.25, 0.75))
    steps = ((low, high), (high, low))
    times = [_measure_rise_s(model, speed, *step) for speed in (-STEP_SPEED_M_S, STEP_SPEED_M_S) for step in steps]
    return sum(times) / len(times)


def _measure_rise_s(model: Model, speed: float, start_A: float, end_A: float) -> float:
    """Step the current and stay at mid-stroke, so that the stroke does not change the force."""
    run, rate = model.make_predictor(), model.sampling.rate_Hz
    before = run_to_steady(model, run, speed, start_A)
    middle = 0.5 * sum(model.envelope.position_m)
    forces = [run.tick(middle, speed, end_A) for _ in range(round(STEP_S * rate))]
    change = forces[-1] - before
    if not isfinite(change) or change == 0.0:
        return 0.0
    return next(k + 1 for k, force in enumerate(forces) if (force - before) / change >= RISE) / rate


def _make_monotone(values: Sequence[float]) -> list[float]:
    """Return the rising sequence nearest to `values` in least squares (pool adjacent violators)."""
    pools: list[tuple[float, int]] = []
    for value in values:
        mean, count = value, 1
        while pools and pools[-1][0] > mean:
            other_mean, other = pools.pop()
            mean, count = (other_mean * other + mean * count) / (other + count), other + count
        pools.append((mean, count))
    return [mean for mean, count in pools for _ in range(count)]


def _space_speeds(fastest: float) -> list[float]:
    """Return rising speeds from InverseLimits.MIN_SPEED_M_S to `fastest`, their spacing growing with speed."""
    return [
        InverseLimits.MIN_SPEED_M_S + (fastest - InverseLimits.MIN_SPEED_M_S) * (k / (SPEEDS - 1)) ** 2
        for k in range(SPEEDS)
    ]


@dataclass(frozen=True)
class InverseMap:
    """Steady force [N] on a grid: `forces_N[n]` is over `currents_A` at `speeds_m_s[n]`, monotone.

    More current means more damping everywhere, or less everywhere. Speeds rise and do not include zero; below the
    smallest the force is proportional to speed, beyond the largest it is constant. Raises CesError for a grid of
    another shape or numbers that are not finite.
    """

    speeds_m_s: tuple[float, ...]
    currents_A: tuple[float, ...]
    forces_N: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        shapes = {len(row) for row in self.forces_N}
        numbers = (*self.speeds_m_s, *self.currents_A, *(force for row in self.forces_N for force in row))
        if len(self.forces_N) != len(self.speeds_m_s) or shapes != {len(self.currents_A)} or len(self.currents_A) < 2:
            raise CesError("inverse map: expected a row of forces for each speed, one force for each current")
        if not all(map(isfinite, numbers)) or not (_is_rising(self.speeds_m_s) and _is_rising(self.currents_A)):
            raise CesError("inverse map: expected finite forces on rising speeds and currents")
        if not self.speeds_m_s[0] < 0.0 < self.speeds_m_s[-1] or 0.0 in self.speeds_m_s:
            raise CesError("inverse map: expected speeds on both sides of zero, without zero")

    @cached_property
    def sense(self) -> float:
        """1 if more current means more damping, -1 if less."""
        signed = zip(self.speeds_m_s, self.forces_N, strict=True)
        return copysign(1.0, sum(copysign(1.0, speed) * (row[-1] - row[0]) for speed, row in signed))

    def row(self, speed_m_s: float) -> list[float]:
        """Return the forces [N] over `currents_A` at this speed."""
        speeds, forces = self.speeds_m_s, self.forces_N
        right = bisect_right(speeds, speed_m_s)
        if right == 0:
            return list(forces[0])
        if right == len(speeds):
            return list(forces[-1])
        left_speed, right_speed = speeds[right - 1], speeds[right]
        if left_speed < 0.0 < right_speed:  # rebound and compression are independent
            nearest, speed = (forces[right], right_speed) if speed_m_s >= 0.0 else (forces[right - 1], left_speed)
            return [speed_m_s / speed * force for force in nearest]
        share = (speed_m_s - left_speed) / (right_speed - left_speed)
        return [a + share * (b - a) for a, b in zip(forces[right - 1], forces[right], strict=True)]

    def force(self, speed_m_s: float, current_A: float) -> float:
        """Return the steady force [N]; a current beyond the grid is clipped to it."""
        points, values = self.currents_A, self.row(speed_m_s)
        right = min(max(bisect_right(points, current_A), 1), len(points) - 1)
        share = min(max((current_A - points[right - 1]) / (points[right] - points[right - 1]), 0.0), 1.0)
        return values[right - 1] + share * (values[right] - values[right - 1])

    def current(self, speed_m_s: float, force_N: float) -> float:
        """Return the current [A] of this force or the nearest possible one; of several the lowest."""
        currents, sense = self.currents_A, self.sense if speed_m_s >= 0.0 else -self.sense
        rising = [sense * force for force in self.row(speed_m_s)]
        target = min(sense * force_N, rising[-1])
        right = bisect_left(rising, target)
        if right == 0:
            return currents[0]
        share = (target - rising[right - 1]) / (rising[right] - rising[right - 1])
        return currents[right - 1] + share * (currents[right] - currents[right - 1])

    def slope(self, speed_m_s: float, current_A: float) -> float:
        """Return dF/di [N/A]: the secant over up to three cells of the grid, because one cell may be flat."""
        row, currents = self.row(speed_m_s), self.currents_A
        right = min(max(bisect_right(currents, current_A), 1), len(currents) - 1)
        low, high = max(right - 2, 0), min(right + 1, len(currents) - 1)
        return (row[high] - row[low]) / (currents[high] - currents[low])


def _is_rising(values: Sequence[float]) -> bool:
    return all(b > a for a, b in pairwise(values))


@dataclass(frozen=True)
class ModelInverse:
    """The inverse map, and the lag of the model's force behind the current [s]."""

    lag_s: float
    map: InverseMap

    @classmethod
    def from_model(cls, model: Model, source: str = "model") -> ModelInverse:
        """Compute it; raises ModelError, naming `source`, if the model's envelope does not suffice for control.

        So does a model with a delay: the controller needs the force that is known at once.
        """
        if delay_s := model.sampling.delay_s:
            raise ModelError(f"{source}: forces come {delay_s:g} s late; a controller needs a model with --delay 0")
        return cls(current_lag_s(model), compute_inverse_map(model, source))

    def to_json(self) -> str:
        """Return it as text, with exact numbers."""
        return json.dumps(write_record(self))

    @classmethod
    def from_json(cls, text: str) -> ModelInverse:
        """Return the inverse whose text `to_json` returned; raises ModelError for any other text."""
        try:
            return read_record(cls, json.loads(text), "inverse", ModelError)
        except (ValueError, RecursionError, ModelError):
            expected = "the text that the model's check writes"
            raise ModelError(f"the inverse of the model cannot be read; expected {expected}") from None
