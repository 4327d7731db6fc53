"""Indistinguishable effects: those that give the same force on some traces, once their parameters are refitted.

A signature is the force that an effect adds to the plant, with derivatives by its parameters. Half the square of the
whitened distance from A, at its fitted values, to B is the expected log-likelihood ratio between A and B if A is true.
The whitening removes differences that the uncertain baseline error could absorb.

Parameters are scaled to the unit box: 0 and 1 are the bounds on a parameter's search scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, permutations

import numpy as np
from scipy.optimize import lsq_linear

from ces_data.arrays import F
from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.evidence import Evidence
from ces_gap.trace import Trace

Whiten = Callable[[int, F], F]  # index of a trace, force [N] (n,) on it -> (m,) with noise of unit variance

STEP = 1e-3  # of a parameter's range: forward differences
FAN, RERUN_FAN = 2, 1  # points of a fan besides the fitted one; of effects that rerun the simulation
NONE = Composition()
TRUST = 0.25  # of a parameter's range: how far shape parameters may move on a tangent
STEPS = 5  # of Gauss-Newton
GAIN = 0.995  # stop after a step that leaves more than this share of the distance
FORM = 0.15  # of a signature's size: the error of a form compared with real physics
EVIDENCE = 3.0  # minimum expected log-likelihood ratio: odds of 20 to 1; the wrong effect fits better 1 time in 9
LIMIT = np.sqrt(2.0 * EVIDENCE)  # the same as a distance
NEAR, ALIKE = 5.0, 0.3  # times the limit, times the smaller effect: linear distances above both are not refined
MAX_REFINED_PAIRS = 8  # the nearest pairs


@dataclass(frozen=True)
class Tangent:
    """A whitened signature on all traces, concatenated: `force` (m,), derivatives (m, p) = `q` (m, p) @ `r` (p, p).

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
    """Computes signatures for `plant` on `traces`, together with the effects of `around`.

    `whiten` must be linear. `around` must not contain the effect itself.
    """

    plant: Plant
    traces: Sequence[Trace]
    whiten: Whiten
    around: Composition = NONE

    def forces(self, setting: Setting) -> tuple[F, ...]:
        """Return the force [N] (n,) that `setting` adds on each trace."""
        forces = self._forces(Composition((*self.around.settings, setting)))
        rows = zip(self.traces, forces, self._forces_without, strict=True)
        return tuple(np.where(t.usable, force - without, 0.0) for t, force, without in rows)

    def tangent(self, setting: Setting) -> Tangent:
        """Return the tangent at `setting`; the simulation runs 1 + p times on each trace if the effect reruns it."""
        forces, point = self.forces(setting), to_unit(setting)
        force, columns = self._whiten_all(forces), []
        for share, axis in zip(point, np.eye(len(point)), strict=True):
            step = STEP if share + STEP <= 1.0 else -STEP
            shifted = self.forces(from_unit(setting.effect, point + step * axis))
            columns.append(self._whiten_all([(g - f) / step for f, g in zip(forces, shifted, strict=True)]))
        q, r = np.linalg.qr(np.array(columns).T.reshape(len(force), -1))
        return Tangent(setting, force, q, r)

    def size(self, setting: Setting) -> float:
        """Return the norm of the whitened signature."""
        return float(np.linalg.norm(self._whiten_all(self.forces(setting))))

    def _whiten_all(self, forces: Sequence[F]) -> F:
        return np.concatenate([self.whiten(k, f) for k, f in enumerate(forces)])

    def _forces(self, composition: Composition) -> list[F]:
        return [p.with_effects(composition, t, alone=a) for t, (p, a) in zip(self.traces, self._plants, strict=True)]

    @cached_property
    def _plants(self) -> list[tuple[Plant, F]]:
        """The plant prepared for each trace, and its force alone [N] (n,)."""
        return [(self.plant.prepare_for(t), self.plant.alone(t)) for t in self.traces]

    @cached_property
    def _forces_without(self) -> list[F]:
        return self._forces(self.around)


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


@dataclass(frozen=True)
class IndistinguishableEffects:
    """Which effects the recordings can distinguish; `matches` by (A, B) say how near B comes to A.

    In each of the `classes`, every effect can replace every other. Effects that are so small at their fitted values
    that the data cannot detect them are in no class.
    """

    matches: Mapping[tuple[str, str], Match]
    classes: tuple[tuple[str, ...], ...]

    def clearest_match(self, a: str, b: str) -> Match:
        """Return the match of two effects in the direction that distinguishes them better."""
        return max(self.matches[a, b], self.matches[b, a], key=lambda m: m.index)

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Return the pairs of indistinguishable effects, the nearest first."""
        inside = [pair for group in self.classes for pair in combinations(group, 2)]
        return tuple(sorted(inside, key=lambda pair: self.clearest_match(*pair).index))


def find_indistinguishable_effects(
    plant: Plant, traces: Sequence[Trace], fitted: Sequence[Setting], whiten: Whiten, around: Composition = NONE
) -> IndistinguishableEffects:
    """Return which of the fitted effects are indistinguishable on these traces.

    `fitted` may hold several forms of an effect: others must match the first, and each may match others. Two effects
    are indistinguishable if the expected log-likelihood ratio is below `EVIDENCE`, where the wrong one fits better with
    probability Φ(−√6/2) = 11 %, or if they differ by less than `FORM` of the signature, because forms are not more
    accurate. `around` are further effects that are present, none of them in `fitted`.
    """
    probe = Probe(plant, traces, whiten, around)
    tangents = [probe.tangent(setting) for setting in fitted]
    size = max((tangent.size for tangent in tangents), default=0.0)
    fans: dict[str, list[Tangent]] = {}
    for tangent in tangents:
        fans.setdefault(tangent.setting.name, []).extend(sample_tangents(probe, tangent, size))
    visible = [name for name, fan in fans.items() if fan[0].size ** 2 / 2.0 >= EVIDENCE]
    matches = {(a, b): find_nearest(fans[a][0], fans[b]) for a, b in permutations(visible, 2)}
    for a, b in _pairs_to_refine({name: fans[name][0].size for name in visible}, matches):
        matches[a, b] = refine_match(fans[a][0], fans[b], probe.tangent)
    index = {(a, b): m.index / max(1.0, FORM * fans[a][0].size / LIMIT) for (a, b), m in matches.items()}
    return IndistinguishableEffects(matches, group_effects(visible, index))


def make_evidence_whitening(evidence: Evidence) -> Whiten:
    """Return the whitening of the evidence's own units, for signatures on its traces."""

    def whiten(trace: int, force: F) -> F:
        return np.concatenate([u.project(evidence.noise.whiten(force)) for u in evidence.units if u.trace == trace])

    return whiten


def group_effects(names: Sequence[str], index: Mapping[tuple[str, str], float]) -> tuple[tuple[str, ...], ...]:
    """Return the groups of at least two names in which all pairs, in both directions, are within the limit.

    Complete linkage merges the two groups whose farthest members are nearest, so that a chain of neighbours does not
    become one class of effects that the data can distinguish.
    """
    groups: list[tuple[str, ...]] = [(name,) for name in names]

    def width(pair: tuple[tuple[str, ...], tuple[str, ...]]) -> float:
        return max(max(index[a, b], index[b, a]) for a in pair[0] for b in pair[1])

    while len(groups) > 1:
        one, other = min(combinations(groups, 2), key=width)
        if width((one, other)) >= LIMIT:
            break
        groups = [g for g in groups if g not in (one, other)] + [one + other]
    order = {name: k for k, name in enumerate(names)}
    large = [tuple(sorted(g, key=order.__getitem__)) for g in groups if len(g) > 1]
    return tuple(sorted(large, key=lambda g: order[g[0]]))


def _pairs_to_refine(size: Mapping[str, float], matches: Mapping[tuple[str, str], Match]) -> list[tuple[str, str]]:
    """Return the ordered pairs to be refined: those near the limit or alike in both directions, nearest first."""
    far = {(a, b): max(matches[a, b].index, matches[b, a].index) for a, b in combinations(size, 2)}
    close = [(a, b) for a, b in far if far[a, b] < max(NEAR * LIMIT, ALIKE * min(size[a], size[b]))]
    close = sorted(close, key=far.__getitem__)[:MAX_REFINED_PAIRS]
    return [ordered for a, b in close for ordered in ((a, b), (b, a))]
