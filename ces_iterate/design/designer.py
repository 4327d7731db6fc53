"""Designs an experiment slot by slot: of many candidates that keep the limits, the one that teaches most is taken.

The gain of a set of candidates has diminishing returns, so choosing one after the other comes close to the best set
(Nemhauser, Wolsey and Fisher 1978; for experiment design Krause, Singh and Guestrin, JMLR 9, 2008). Everything depends
on the seed only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ces_iterate.commands import INTERVAL_S, Commands
from ces_iterate.design.currents import draw_current
from ces_iterate.design.features import Features, scaled_state
from ces_iterate.design.information import EVERY_S, Information
from ces_iterate.design.motions import draw_motion, peak_share
from ces_iterate.errors import IterateError
from ces_iterate.plan.limits import RigLimits

F = NDArray[np.float64]

BLEND_S = 0.4  # of the transition between two motions, and from and to rest
CANDIDATES = 120  # for each slot
MAX_DRAWS = 20  # for each candidate, until one keeps the limits
SLOT_S = 2.5  # about the length of a motion
MARGIN = 0.002  # below the limits: differences of samples are a little below the peaks of the spline

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
class _Part:
    """The stroke of a slot of `count` grid points with the tail that blends into what follows; the slot's current."""

    stroke_m: F
    current_A: F
    count: int

    @property
    def slot(self) -> F:
        """Stroke in the slot, (count,)."""
        return self.stroke_m[: self.count]

    @property
    def tail(self) -> F:
        """Stroke after the slot."""
        return self.stroke_m[self.count :]


@dataclass(frozen=True)
class _Judged:
    """A part with its gain, what is known (before it, or once chosen after it), and the heat load at its end."""

    part: _Part
    gain: float
    information: Information
    load_W: float


def design_experiment(
    task: DesignTask, name: str, duration_s: float, seed: int, candidates: int = CANDIDATES
) -> Commands:
    """Return the commands of an experiment that keeps all limits; raises IterateError if no candidate keeps them.

    Each slot takes the best of so many `candidates`; with 1 it is a random experiment within the limits.
    """
    rng = np.random.default_rng([seed, 17])
    slots = max(1, round(duration_s / SLOT_S))
    counts = np.diff(np.linspace(0, round(duration_s / INTERVAL_S), slots + 1).astype(int))
    centre, tail = task.limits.centre_m, len(_blend())
    best = _Judged(
        _Part(np.full(1 + tail, centre), np.full(1, task.limits.low_A), 1), 0.0, task.information, task.load_W
    )
    chosen: list[_Part] = []
    for count in map(int, counts):
        best = _best_part(task, best, count, len(chosen) == slots - 1, candidates, rng, name)
        chosen.append(best.part)
    stroke = np.concatenate([[centre], *(part.slot for part in chosen)])
    current = np.concatenate([chosen[0].current_A[:1], *(part.current_A for part in chosen)])
    return task.limits.require_within(_settle(Commands(name, stroke, current, seed), task.limits))


def _best_part(
    task: DesignTask, before: _Judged, count: int, last: bool, candidates: int, rng: Generator, name: str
) -> _Judged:
    """Return the best of the candidates that keep the limits, with what is known after it."""
    weighed = before.information.weigh(task.targets, task.weights)
    found: list[_Judged] = []
    for _ in range(MAX_DRAWS * candidates):
        part = _draw_part(task.limits, count, before.part, last, rng)
        judged = _judge(task, before, part, weighed)
        if judged is not None:
            found.append(judged)
        if len(found) == candidates:
            break
    if not found:
        raise IterateError(f"{name}: no motion keeps the limits; allow more speed, acceleration or heat")
    best = max(found, key=lambda one: one.gain)
    rows = _rows(best.part.slot, best.part.current_A, task.limits, task.features)
    return replace(best, information=before.information.add(rows))


def rows_of(commands: Commands, limits: RigLimits, features: Features) -> F:
    """Return the features (n, COUNT) of an experiment, one row every `EVERY_S`."""
    return _rows(commands.stroke_m, commands.current_A, limits, features)


def _draw_part(limits: RigLimits, count: int, before: _Part, last: bool, rng: Generator) -> _Part:
    """Return a candidate that blends from the tail of the part before, and at the `last` slot into rest."""
    blend, tail = _blend(), len(before.tail)
    stroke = limits.centre_m + draw_motion(limits, count + tail, rng)
    stroke[:tail] = (1.0 - blend) * before.tail + blend * stroke[:tail]
    if last:
        end = slice(count - tail, count)
        stroke[end] = (1.0 - blend) * stroke[end] + blend * limits.centre_m
        stroke[count:] = limits.centre_m
    return _Part(stroke, draw_current(limits, count, rng), count)


def _judge(task: DesignTask, before: _Judged, part: _Part, weighed: F) -> _Judged | None:
    """Return a candidate with its gain and heat load; None if it leaves the limits."""
    joined = np.concatenate([before.part.slot[-2:], part.stroke_m])
    if peak_share(joined - task.limits.centre_m, task.limits) > 1.0 - MARGIN:
        return None
    load = _load(task, part, before.load_W)
    if load.max() > task.limits.heat.power_W > 0.0:
        return None
    rows = _rows(part.slot, part.current_A, task.limits, task.features)
    return _Judged(part, before.information.gain(rows, weighed), before.information, float(load[-1]))


def _load(task: DesignTask, part: _Part, load_W: float) -> F:
    """Return the heat load [W] (n,) during a slot; that at its start if nothing limits it."""
    if task.limits.heat.power_W == 0.0:
        return np.full(1, load_W)
    return task.limits.heat.load_after(load_W, task.power(part.slot, part.current_A), INTERVAL_S)


def _rows(stroke_m: F, current_A: F, limits: RigLimits, features: Features) -> F:
    speed = np.gradient(stroke_m, INTERVAL_S)
    step = round(EVERY_S / INTERVAL_S)
    return features.at(scaled_state(stroke_m, speed, current_A, limits)[step::step])


def _blend() -> F:
    """Return a rise from 0 to 1 within BLEND_S, twice differentiable."""
    u = (np.arange(round(BLEND_S / INTERVAL_S)) + 1) / (round(BLEND_S / INTERVAL_S) + 1)
    return np.asarray(u**3 * (10.0 + u * (6.0 * u - 15.0)))


def _settle(commands: Commands, limits: RigLimits) -> Commands:
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
    return Commands(commands.name, stroke, commands.current_A, commands.seed)
