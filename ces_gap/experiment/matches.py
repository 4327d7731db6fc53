"""Matches: how near one effect comes to another on a trace, once its parameters are refitted.

A signature is the force that an effect adds to the plant, with derivatives by its parameters. Half the square of the
whitened distance from A, at its fitted values, to B is the expected log-likelihood ratio between A and B if A is true.

Parameters are scaled to the unit box: 0 and 1 are the bounds on a parameter's search scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from ces_data.arrays import F
from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.trace import Trace

Whiten = Callable[[F], F]  # force [N] (n,) on a trace -> (m,) with noise of unit variance

STEP = 1e-3  # of a parameter's range: forward differences
FAN, RERUN_FAN = 2, 1  # points of a fan besides the fitted one; of effects that rerun the simulation
TRUST = 0.25  # of a parameter's range: how far shape parameters may move on a tangent
STEPS = 5  # of Gauss-Newton
GAIN = 0.995  # stop after a step that leaves more than this share of the distance


@dataclass(frozen=True)
class Tangent:
    """A whitened signature on a trace: `force` (m,), derivatives (m, p) = `q` (m, p) @ `r` (p, p).

    It touches the effect at `setting`.
    """

    setting: Setting
    force: F
    q: F
    r: F

    @property
    def size(self) -> float:
        """How visible the effect is: the norm of its whitened signature."""
        return float(np.linalg.norm(self.force))


@dataclass(frozen=True)
class Probe:
    """Computes signatures for `plant` on a `trace`; `whiten` must be linear."""

    plant: Plant
    trace: Trace
    whiten: Whiten

    def force(self, setting: Setting) -> F:
        """Return the force [N] (n,) that `setting` adds."""
        plant, alone = self._plant_and_force
        return np.asarray(plant.with_effects(Composition((setting,)), self.trace, alone) - alone)

    def tangent(self, setting: Setting) -> Tangent:
        """Return the tangent at `setting`; the simulation runs 1 + p times if the effect reruns it."""
        force, point, columns = self.force(setting), to_unit(setting), []
        for share, axis in zip(point, np.eye(len(point)), strict=True):
            step = STEP if share + STEP <= 1.0 else -STEP
            shifted = self.force(from_unit(setting.effect, point + step * axis))
            columns.append(self.whiten((shifted - force) / step))
        whitened = self.whiten(force)
        q, r = np.linalg.qr(np.array(columns).T.reshape(len(whitened), -1))
        return Tangent(setting, whitened, q, r)

    def size(self, setting: Setting) -> float:
        """Return the norm of the whitened signature."""
        return float(np.linalg.norm(self.whiten(self.force(setting))))

    @cached_property
    def _plant_and_force(self) -> tuple[Plant, F]:
        """The plant prepared for the trace, and its force alone [N] (n,)."""
        return self.plant.prepare_for(self.trace), self.plant.alone(self.trace)


def sample_tangents(probe: Probe, fitted: Tangent, size: float) -> list[Tangent]:
    """Return tangents of an effect at its fitted values and at a few of its starts.

    At the starts, magnitudes are scaled for a signature of norm `size`, that of the gap.
    """
    effect = fitted.setting.effect
    count = min(RERUN_FAN if effect.reruns else FAN, max((len(p.starts) for p in effect.parameters), default=0))
    starts = [Setting(effect, tuple(p.starts[k % len(p.starts)] for p in effect.parameters)) for k in range(count)]
    points = dict.fromkeys(_scale_setting(s, size / max(probe.size(s), 1e-9 * size)) for s in starts)
    return [fitted, *(probe.tangent(p) for p in points if p != fitted.setting)]


def to_unit(setting: Setting) -> F:
    """Return the values (p,) as shares of their search ranges."""
    pairs = list(zip(setting.effect.parameters, setting.values, strict=True))
    return np.array([(p.to_search(v) - p.search_bounds()[0]) / _width(p) for p, v in pairs])


def from_unit(effect: Effect, point: F) -> Setting:
    """Return the setting at the shares `point` (p,) of the search ranges; the inverse of `to_unit`."""
    pairs = zip(effect.parameters, point, strict=True)
    return Setting(effect, tuple(p.to_value(p.search_bounds()[0] + float(u) * _width(p)) for p, u in pairs))


def _width(parameter: EffectParameter) -> float:
    low, high = parameter.search_bounds()
    return max(high - low, 1e-300)


def _scale_setting(setting: Setting, factor: float) -> Setting:
    """Return the setting with the distances of its magnitudes from neutral scaled by `factor`, inside the bounds."""
    values = []
    for p, value in zip(setting.effect.parameters, setting.values, strict=True):
        inverse = p.scale == "inverse"
        scaled = value / max(factor, 1e-12) if inverse else p.neutral + factor * (value - p.neutral)
        values.append(float(min(max(scaled, p.low), p.high)) if p.magnitude else value)
    return Setting(setting.effect, tuple(values))


@dataclass(frozen=True)
class Match:
    """The nearest that B comes to A: at `setting` of B, ‖W(s_A − s_B)‖ is `index`."""

    setting: Setting
    index: float

    @property
    def evidence(self) -> float:
        """Expected log-likelihood ratio for A over B if A is true."""
        return self.index**2 / 2.0


def find_nearest(a: Tangent, fan_b: Sequence[Tangent]) -> Match:
    """Return how near B comes to A on B's tangents, inside its bounds, without a simulation."""
    return min((_match_on_tangent(a, b, TRUST) for b in fan_b), key=lambda match: match.index)


def refine_match(
    a: Tangent, fan_b: Sequence[Tangent], tangent: Callable[[Setting], Tangent], steps: int = STEPS
) -> Match:
    """Return how near B comes to A when B is evaluated: Gauss-Newton inside a trust region.

    The start is the nearest point according to the tangents, or the point of a tangent if that is nearer. `tangent`
    returns B's tangent at a setting. The true distance is at most the one returned.
    """
    best = min((tangent(find_nearest(a, fan_b).setting), *fan_b), key=lambda b: _whitened_distance(a, b))
    index, radius = _whitened_distance(a, best), TRUST
    for _ in range(steps):
        moved = tangent(_match_on_tangent(a, best, radius, free=False).setting)
        now = _whitened_distance(a, moved)
        if now >= index:
            radius /= 3.0
            continue
        converged, best, index, radius = now > GAIN * index, moved, now, 2.0 * radius
        if converged:
            break
    return Match(best.setting, index)


def _match_on_tangent(a: Tangent, b: Tangent, trust: float, free: bool = True) -> Match:
    """Return how near B's tangent comes to A: bounded linear least squares, shape parameters inside `trust`.

    With `free`, magnitudes may move over their whole range.
    """
    point, apart = to_unit(b.setting), a.force - b.force
    reach = np.array([1.0 if free and p.magnitude else trust for p in b.setting.effect.parameters])
    low, high = np.maximum(-point, -reach), np.minimum(1.0 - point, reach)
    move = _solve_bounded_step(b.r, b.q.T @ apart, low, high)
    index = float(np.linalg.norm(apart - b.q @ (b.r @ move)))
    return Match(from_unit(b.setting.effect, point + move), index)


def _solve_bounded_step(r: F, goal: F, low: F, high: F) -> F:
    """Return the move (p,) inside [low, high] that brings `r` @ move nearest to `goal`."""
    move: F = np.asarray(np.linalg.lstsq(r, goal, rcond=1e-9)[0], dtype=np.float64)
    if np.all((move >= low) & (move <= high)):
        return move
    movable = high - low > 1e-12
    bounded = np.zeros(len(low))
    if movable.any():
        bounded[movable] = lsq_linear(r[:, movable], goal, (low[movable], high[movable]), method="bvls").x
    return np.clip(bounded, low, high)


def _whitened_distance(a: Tangent, b: Tangent) -> float:
    return float(np.linalg.norm(a.force - b.force))
