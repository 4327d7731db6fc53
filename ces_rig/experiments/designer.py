"""Designs an experiment slot by slot: of many candidates that keep the limits, the one that teaches most is taken.

The gain of a set of candidates has diminishing returns, so choosing one after the other comes close to the best set
(Nemhauser, Wolsey and Fisher 1978; for experiment design Krause, Singh and Guestrin, JMLR 9, 2008). Everything depends
on the seed only. The newest model predicts the heat that an experiment brings; recordings show what it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_data.waveforms.strokes import smooth_step
from ces_identify.prepare.series import hold_current
from ces_identify.simulations.simulate import simulate_series
from ces_observer.model import Model
from ces_rig.errors import RigError
from ces_rig.experiments.commands import INTERVAL_S, HeatLimits, RigCommands, RigLimits
from ces_rig.experiments.information import EVERY_S, Features, Information, scaled_state, series_of
from ces_rig.experiments.random_motions import draw_current, draw_motion, peak_share
from ces_rig.limits import DesignLimits

BLEND_S = 0.4  # of the transition between two motions, and from and to rest
BLEND = smooth_step((np.arange(round(BLEND_S / INTERVAL_S)) + 1) / (round(BLEND_S / INTERVAL_S) + 1))
CANDIDATES = 120  # for each slot
MAX_DRAWS = 20  # for each candidate, until one keeps the limits
SLOT_S = 2.5  # about the length of a motion
SMOOTHING = 21  # grid points of the quadratic smoothing of a recorded stroke
MAX_AGE_S = 1.0  # of a recorded current that is held

PowerModel = Callable[[F, F], F]
"""Dissipated power [W] (n,) of stroke [m] and current [A], each (n,) on the commands' grid."""


@dataclass(frozen=True)
class DesignTask:
    """What the next experiment is for: `targets` (m, features) with `weights` (m,), and what is known already.

    `load_W` is the heat load before the experiment, `power` what predicts the dissipated power.
    """

    limits: RigLimits
    features: Features
    information: Information
    targets: F
    weights: F
    power: PowerModel
    load_W: float = 0.0


@dataclass(frozen=True)
class _MotionCandidate:
    """The stroke of a slot of `count` grid points with the tail that blends into what follows, and the slot's current.

    `load_W` is the heat load at the slot's end, `gain` what the candidate teaches.
    """

    stroke_m: F
    current_A: F
    count: int
    load_W: float
    gain: float = 0.0

    @property
    def slot(self) -> F:
        return self.stroke_m[: self.count]


def design_experiment(
    task: DesignTask, name: str, duration_s: float, seed: int, candidates: int = CANDIDATES
) -> RigCommands:
    """Return the commands of an experiment that keeps all limits; raises RigError if no candidate keeps them.

    Each slot takes the best of so many `candidates`; with 1 it is a random experiment within the limits.
    """
    rng, limits = np.random.default_rng([seed, 17]), task.limits
    slots = max(1, round(duration_s / SLOT_S))
    counts = np.diff(np.linspace(0, round(duration_s / INTERVAL_S), slots + 1).astype(int))
    rest = np.full(1 + len(BLEND), limits.centre_m)
    best, information = _MotionCandidate(rest, np.full(1, limits.low_A), 1, task.load_W), task.information
    chosen: list[_MotionCandidate] = []
    for count in map(int, counts):
        weighed = information.weigh(task.targets, task.weights)
        drawn: list[_MotionCandidate] = []
        for _ in range(MAX_DRAWS * candidates):
            candidate = _draw_candidate(task, best, count, len(chosen) == slots - 1, rng)
            if candidate is not None:
                rows = rows_of(candidate.slot, candidate.current_A, limits, task.features)
                drawn.append(replace(candidate, gain=information.gain(rows, weighed)))
            if len(drawn) == candidates:
                break
        if not drawn:
            raise RigError(f"{name}: no motion keeps the limits; allow more speed, acceleration or heat")
        best = max(drawn, key=lambda candidate: candidate.gain)
        information = information.add(rows_of(best.slot, best.current_A, limits, task.features))
        chosen.append(best)
    stroke = np.concatenate([[limits.centre_m], *(candidate.slot for candidate in chosen)])
    current = np.concatenate([chosen[0].current_A[:1], *(candidate.current_A for candidate in chosen)])
    return limits.require_within(_settle(RigCommands(name, stroke, current, seed), limits))


def rows_of(stroke_m: F, current_A: F, limits: RigLimits, features: Features) -> F:
    """Return the features (n, COUNT) of an experiment, one row every `EVERY_S`."""
    speed, step = np.gradient(stroke_m, INTERVAL_S), round(EVERY_S / INTERVAL_S)
    return features.at(scaled_state(stroke_m, speed, current_A, limits)[step::step])


def _draw_candidate(
    task: DesignTask, before: _MotionCandidate, count: int, is_last: bool, rng: Generator
) -> _MotionCandidate | None:
    """Return a candidate that blends from the tail of the slot before, and in the last slot into rest.

    None if it leaves the limits.
    """
    limits, tail = task.limits, len(BLEND)
    stroke = limits.centre_m + draw_motion(limits, count + tail, rng)
    stroke[:tail] = (1.0 - BLEND) * before.stroke_m[before.count :] + BLEND * stroke[:tail]
    if is_last:
        end = slice(count - tail, count)
        stroke[end] = (1.0 - BLEND) * stroke[end] + BLEND * limits.centre_m
        stroke[count:] = limits.centre_m
    current = draw_current(limits, count, rng)
    joined = np.concatenate([before.slot[-2:], stroke])
    if peak_share(joined - limits.centre_m, limits) > 1.0 - DesignLimits.MARGIN:
        return None
    load = np.full(1, before.load_W)
    if limits.heat.power_W > 0.0:
        load = limits.heat.load_after(before.load_W, task.power(stroke[:count], current), INTERVAL_S)
        if load.max() > limits.heat.power_W:
            return None
    return _MotionCandidate(stroke, current, count, float(load[-1]))


def _settle(commands: RigCommands, limits: RigLimits) -> RigCommands:
    """Return the commands, scaled a little towards the centre if the spline's peaks leave the limits."""
    time = commands.time_s
    spline = CubicSpline(time, commands.stroke_m - limits.centre_m)
    share = max(
        float(np.abs(spline(time)).max()) / limits.stroke_m,
        float(np.abs(spline(time, 1)).max()) / limits.speed_m_s,
        float(np.abs(spline(time, 2)).max()) / limits.acceleration_m_s2,
        1.0,
    )
    stroke = limits.centre_m + (commands.stroke_m - limits.centre_m) / share
    return RigCommands(commands.name, stroke, commands.current_A, commands.seed)


def recorded_commands(recording: Recording) -> RigCommands:
    """Return the smoothed stroke and the held current of a recording; gaps are bridged by straight lines."""
    position = recording.channel("position")
    good = np.isfinite(position.values)
    stamps, first = np.unique(position.stamps_ns[good], return_index=True)
    grid = np.arange(stamps[0], stamps[-1] + 1, round(INTERVAL_S * 1e9))
    time = (grid - stamps[0]).astype(np.float64)
    stroke = np.interp(time, (stamps - stamps[0]).astype(np.float64), position.values[good][first])
    current = hold_current(recording, grid, MAX_AGE_S)
    known = np.isfinite(current)
    filled = np.interp(time, time[known], current[known]) if known.any() else np.zeros(len(time))
    return RigCommands(recording.name, savgol_filter(stroke, SMOOTHING, polyorder=2), filled)


def dissipated_W(force_N: F, speed_m_s: F) -> F:
    """Return the power [W] that heats the damper, never negative: what springs give back heats nothing."""
    return np.maximum(force_N * speed_m_s, 0.0)


def recorded_power(recording: Recording) -> F:
    """Return the dissipated power [W] on the grid of the commands, (n,)."""
    commands, force = recorded_commands(recording), recording.channel("force")
    start = int(recording.channel("position").stamps_ns.min())
    at = (force.stamps_ns - start) * 1e-9
    good = np.isfinite(force.values)
    return dissipated_W(np.interp(commands.time_s, at[good], force.values[good]), commands.motion()[0])


def make_power_model(model: Model | None, heat: HeatLimits) -> PowerModel:
    """Return what predicts the dissipated power: the model, or without one the expected force times the speed."""
    if model is None:
        return lambda stroke_m, _: np.asarray(heat.force_N * np.abs(np.gradient(stroke_m, INTERVAL_S)))

    def simulated(stroke_m: F, current_A: F) -> F:
        series = series_of(RigCommands("candidate", stroke_m, current_A), model.sampling.rate_Hz)
        power = dissipated_W(simulate_series(model, series).force, series.speed)
        power = np.where(np.isfinite(power), power, heat.force_N * np.abs(series.speed))
        return np.asarray(np.interp(np.arange(len(stroke_m)) * INTERVAL_S, series.time_s, power))

    return simulated


def plan_rest(heat: HeatLimits, load_W: float) -> tuple[float, float]:
    """Return the rest [s] that a damper needs before an experiment, and its load [W] afterwards."""
    rest = heat.cool_down_s(load_W, DesignLimits.START_LOAD * heat.power_W)
    return rest, load_W * float(np.exp(-rest / heat.memory_s))
