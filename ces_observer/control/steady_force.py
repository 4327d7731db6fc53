"""The steady force of the observer's model, exact where its structure can tell, else from runs at constant inputs.

A model goes in; the controller's inverse map and the lag of force behind current come out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import copysign, isfinite

from ces_observer.control.inverse_map import InverseMap
from ces_observer.errors import ModelError
from ces_observer.model import Model
from ces_observer.structures.structure import Predictor

SPEEDS = 24  # of the grid, on each side of zero; denser towards zero, where the force is steep
CURRENTS = 17
SETTLING_S = 0.3  # of constant speed and current before the force is read: ten times a real valve's lag
STEP_S = 0.1
RISE = 0.632
STEP_SPEED_M_S = 0.15  # during a step of current
MIN_SPEED_M_S = 0.02  # of the grid: below, oil and seals yield before the valve has an effect


def compute_inverse_map(model: Model, source: str = "model") -> InverseMap:
    """Return the inverse of the model's steady force over its envelope of speeds and currents.

    Raises ModelError, naming `source`, if the envelope lacks a direction of motion or has only one current.
    """
    slowest, fastest = model.envelope.speed_m_s
    lowest, highest = model.envelope.current_A
    if not slowest < -MIN_SPEED_M_S < MIN_SPEED_M_S < fastest:
        raise ModelError(f"{source}: speeds from {slowest:g} to {fastest:g} m/s; a controller needs both directions")
    if not lowest < highest:
        raise ModelError(f"{source}: identified at {lowest:g} A only; identify it on recordings of several currents")
    speeds = (*(-v for v in reversed(_space_speeds(-slowest))), *_space_speeds(fastest))
    currents = tuple(lowest + (highest - lowest) * k / (CURRENTS - 1) for k in range(CURRENTS))
    run = model.make_predictor()
    rows = [[steady_force(model, run, speed, current) for current in currents] for speed in speeds]
    return InverseMap(speeds, currents, tuple(_make_rows_monotone(speeds, rows)))


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

    The model clamps a stroke beyond its envelope. A force outside the force envelope counts as that envelope's end.
    """
    rate = model.sampling.rate_Hz
    ticks = round(SETTLING_S * rate)
    middle = 0.5 * sum(model.envelope.position_m)
    run.reset()
    force = 0.0
    for tick in range(-ticks, 1):
        force = run.tick(middle + speed_m_s * tick / rate, speed_m_s, current_A)
        if not isfinite(force):
            return model.force_envelope_N[speed_m_s > 0.0]
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


def _make_rows_monotone(speeds: Sequence[float], rows: list[list[float]]) -> Iterator[tuple[float, ...]]:
    """Make every row monotone in the valve's overall sense: more current gives more (or less) damping."""
    stiffer = sum(copysign(1.0, v) * (row[-1] - row[0]) for v, row in zip(speeds, rows, strict=True))
    for speed, row in zip(speeds, rows, strict=True):
        sense = copysign(1.0, speed * stiffer)
        yield tuple(sense * force for force in _make_monotone([sense * force for force in row]))


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
    """Return rising speeds from MIN_SPEED_M_S to `fastest`, their spacing growing with speed."""
    return [MIN_SPEED_M_S + (fastest - MIN_SPEED_M_S) * (k / (SPEEDS - 1)) ** 2 for k in range(SPEEDS)]
