"""How near one effect can come to another: the smallest ‖W(s_A − s_B)‖ over B's parameters, inside their bounds.

s is the force that an effect adds, with fixed parameters for A; W whitens the noise. The minimum is computed on a fan
of B's tangents, which needs no simulation, and refined where necessary by a few Gauss-Newton steps on B itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ces_gap.effects.effect import Setting
from ces_gap.experiment.signatures import Signature, Tangent, from_unit, to_unit
from ces_gap.trace import F

TRUST = 0.25  # of a parameter's range: how far shape parameters may move on a tangent
STEPS = 5  # of Gauss-Newton
GAIN = 0.995  # stop after a step that leaves more than this share of the distance


@dataclass(frozen=True)
class Match:
    """The nearest that B comes to A: at `setting` of B, ‖W(s_A − s_B)‖ is `index` and the RMS of s_A − s_B is `rms_N`.

    If not `refined`, s_B lies on a tangent: B itself was not evaluated at these values.
    """

    setting: Setting
    index: float
    rms_N: float
    refined: bool = False

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
    return Match(best.setting, index, _rms(a.signature, best.signature), refined=True)


def _match_on_tangent(a: Tangent, b: Tangent, trust: float, free: bool = True) -> Match:
    """Return how near B's tangent comes to A: bounded linear least squares, shape parameters inside `trust`.

    With `free`, magnitudes may move over their whole range.
    """
    goal = b.q.T @ (a.force - b.force)
    move = _solve_bounded_step(b.r, goal, *_box(b.setting, trust, free))
    index = float(np.linalg.norm(a.force - b.force - b.q @ (b.r @ move)))
    return Match(from_unit(b.setting.effect, to_unit(b.setting) + move), index, _rms(a.signature, b.signature, move))


def _box(setting: Setting, trust: float, free: bool) -> tuple[F, F]:
    """Return how far each share (p,) may move down and up."""
    point = to_unit(setting)
    reach = np.array([1.0 if free and p.magnitude else trust for p in setting.effect.parameters])
    return np.maximum(-point, -reach), np.minimum(1.0 - point, reach)


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


def _rms(a: Signature, b: Signature, move: F | None = None) -> float:
    """Return the RMS [N] of s_A − s_B over the usable ticks, B moved along its tangent."""
    energy = 0.0
    for f, g, columns in zip(a.forces, b.forces, b.columns, strict=True):
        rest = f - g if move is None else f - g - columns @ move
        energy += float(rest @ rest)
    return float(np.sqrt(energy / max(a.ticks, 1)))
