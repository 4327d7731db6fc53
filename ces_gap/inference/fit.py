"""Fitting effects: bounded Levenberg-Marquardt on whitened residuals, with cross-validation over units.

Cross-validation is linearised: one Gauss-Newton step from the fit of all units gives the fit without one unit and its
residual on that unit (exact for effects that are linear in their parameters). The parameters' intervals follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.inference.evidence import Evidence
from ces_gap.limits import SearchLimits
from ces_gap.progress import Progress, ignore_progress

ITERATIONS = 8
STEP = 1e-3  # of a parameter's range: step of the difference quotients
MIN_GAIN = 3e-4  # share of the gap's energy: an iteration that explains less is the last
MIN_EXPLAINED = 0.005  # of the gap's energy: a fit that explains less is not continued
MAX_STARTS = 6
MAX_SCALED_STARTS = 2  # starts whose magnitude is scaled to fit
Z95 = 1.96
MAX_REPEATS, SETTLED = 5, 0.1  # of a fit; standard errors by which a settled parameter moves

Interval = tuple[float, float]


@dataclass(frozen=True)
class EffectFit:
    """Effects fitted together.

    `searched` (p,) are the parameters on their search scales. `residual` (r,) and `jacobian` (r, p) of the modelled
    force are whitened. `by_unit` (u, p) are the parameters fitted without each unit, `left_out` (r,) the residuals on
    the units left out. `covariance` (p, p) of the parameters is clustered by blocks.
    """

    effects: tuple[Effect, ...]
    searched: F
    residual: F
    jacobian: F
    left_out: F
    by_unit: F
    covariance: F

    @property
    def composition(self) -> Composition:
        """The effects with their values."""
        return make_composition(self.effects, self.searched)

    @property
    def names(self) -> tuple[str, ...]:
        """The effects' names."""
        return tuple(e.name for e in self.effects)

    @property
    def cost(self) -> float:
        """Whitened sum of squares on the units left out."""
        return float(self.left_out @ self.left_out)


def make_composition(effects: Sequence[Effect], searched: F) -> Composition:
    """Return the composition of effects at searched values (p,)."""
    values = iter(searched.tolist())
    return Composition(tuple(Setting(e, tuple(p.to_value(next(values)) for p in e.parameters)) for e in effects))


def bounds(effects: Sequence[Effect], at: F | None = None) -> tuple[F, F]:
    """Return the lowest and highest searched values (p,) of some effects.

    With `at` (p,), those of a search from there: the usual ranges, but all that is plausible for a parameter that is
    not inside its usual range.
    """
    parameters = [p for effect in effects for p in effect.parameters]
    low, high = np.array([p.search_bounds() for p in parameters]).reshape(-1, 2).T
    if at is None:
        return low, high
    usual_low, usual_high = np.array([p.search_bounds(usual=True) for p in parameters]).reshape(-1, 2).T
    near = SearchLimits.NEAR_BOUND * (usual_high - usual_low)
    beyond = ((at - usual_low < near) & (low < usual_low)) | ((usual_high - at < near) & (high > usual_high))
    return np.where(beyond, low, usual_low), np.where(beyond, high, usual_high)


def fit_alone(evidence: Evidence, effect: Effect) -> EffectFit:
    """Return the best fit of one effect from its starts."""
    objective = _Objective(evidence, (effect,))
    return _fit_from(objective, *_choose_start(objective, starts(evidence, effect)))


def fit_together(evidence: Evidence, parts: Sequence[EffectFit]) -> EffectFit:
    """Return the joint fit of the effects of some fits, started from their parameters."""
    effects = tuple(e for part in parts for e in part.effects)
    return fit_from(evidence, effects, np.concatenate([part.searched for part in parts]))


def fit_promising(
    evidence: Evidence, effects: Sequence[Effect], count: int, progress: Progress = ignore_progress
) -> list[EffectFit]:
    """Return the fits of the `count` effects of which a form leaves least at its best start, least first.

    Of an effect, a form with more parameters must leave clearly less.
    """
    begun: dict[str, tuple[float, _Objective, F, F]] = {}
    for k, effect in enumerate(sorted(effects, key=lambda e: len(e.parameters))):
        progress(f"trying {effect.name}", k / len(effects))
        objective = _Objective(evidence, (effect,))
        point, residual = _choose_start(objective, starts(evidence, effect))
        left, gap = float(residual @ residual), float(objective.baseline_residual @ objective.baseline_residual)
        simpler = begun.get(effect.name)
        more = simpler is not None and len(effect.parameters) > len(simpler[1].low)
        if simpler is None or left < simpler[0] - more * SearchLimits.MIN_FORM_GAIN * max(gap - len(residual), 0.0):
            begun[effect.name] = (left, objective, point, residual)
    best = sorted(begun.values(), key=lambda start: start[0])[:count]
    return sorted((_fit_from(*start[1:]) for start in best), key=lambda fit: fit.cost)


def linearise(evidence: Evidence, effects: tuple[Effect, ...], searched: F) -> tuple[F, F]:
    """Return the whitened residual (r,) and the Jacobian (r, p) of the modelled force at searched values (p,)."""
    objective = _Objective(evidence, effects)
    residual = objective(searched)
    return residual, objective.jacobian(searched, residual)


def fit_to_the_end(evidence: Evidence, effects: tuple[Effect, ...], start: F) -> EffectFit:
    """Return the fit from `start` (p,), repeated until no parameter moves by a noteworthy part of its error."""
    fit = fit_from(evidence, effects, start)
    for _ in range(MAX_REPEATS):
        before, fit = fit, fit_from(evidence, effects, fit.searched)
        errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        if (np.abs(fit.searched - before.searched) <= SETTLED * errors).all():
            break
    return fit


def fit_from(evidence: Evidence, effects: tuple[Effect, ...], start: F) -> EffectFit:
    """Return the fit that Levenberg-Marquardt reaches from `start` (p,) inside the bounds."""
    objective = _Objective(evidence, effects)
    searched = np.clip(start, objective.low, objective.high)
    return _fit_from(objective, searched, objective(searched))


def starts(evidence: Evidence, effect: Effect) -> list[F]:
    """Return start points (each (p,)): the effect's own for these traces, or combinations of its parameters' starts.

    They are made for the trace with the longest stroke: if any reaches the limits, this one does.
    """
    widest = max(evidence.traces, key=lambda t: float(np.ptp(t.inputs.position[t.usable])))
    values = effect.starts_for(widest) or Effect.starts_for(effect, widest)
    spaced = values[:: max(1, -(-len(values) // MAX_STARTS))]
    searched = [[p.to_search(x) for p, x in zip(effect.parameters, v, strict=True)] for v in spaced]
    low, high = bounds((effect,))
    return [np.clip(np.array(u), low, high) for u in searched]


class _Objective:
    """The whitened residual (r,) as a function of searched values (p,), inside the `bounds` of a search from `at`."""

    def __init__(self, evidence: Evidence, effects: tuple[Effect, ...], at: F | None = None) -> None:
        self.evidence, self.effects = evidence, effects
        self.low, self.high = bounds(effects, at)
        self.baseline_residual = evidence.residual(evidence.alone)
        parameters = [p for effect in effects for p in effect.parameters]
        self.magnitudes = {  # the searched value without effect of each parameter, by number, that is a magnitude
            k: p.to_search(p.neutral) if np.isfinite(p.neutral) else 0.0
            for k, p in enumerate(parameters)
            if p.magnitude and p.scale != "log"
        }

    def forces(self, searched: F) -> list[F]:
        return self.evidence.forces(make_composition(self.effects, searched))

    def __call__(self, searched: F) -> F:
        residual = self.evidence.residual(self.forces(searched))
        return residual if np.isfinite(residual).all() else np.full_like(residual, 1e6)

    def jacobian(self, searched: F, residual: F) -> F:
        """Return the Jacobian (r, p) of the modelled force by one-sided differences, away from the nearer bound.

        A step after which there is no force, as where a simulation of the user fails, is made in the other direction.
        """
        span = self.high - self.low
        size = STEP * np.maximum(np.minimum(span, 10.0 * np.abs(searched)), 0.02 * span)
        given = np.array([p.step for effect in self.effects for p in effect.parameters])
        size = np.where(given > 0.0, given, size)
        steps = np.where(searched + size <= self.high, size, -size)
        moved = [self.forces(searched + step * unit) for step, unit in zip(steps, np.eye(len(searched)), strict=True)]
        for k in [k for k, forces in enumerate(moved) if not all(np.isfinite(f).all() for f in forces)]:
            steps[k] *= -1.0
            moved[k] = self.forces(searched + steps * (np.arange(len(steps)) == k))
        out = residual[:, None] - self.evidence.residual(list(map(np.column_stack, zip(*moved, strict=True))))
        out = np.where(np.isfinite(out).all(axis=0), out, -1e6)
        return np.asarray(out / steps)


def _choose_start(objective: _Objective, points: Sequence[F]) -> tuple[F, F]:
    """Return the start point (p,) that leaves least, and the residual (r,) there.

    The magnitudes of the most promising points are scaled by the factor that fits best if the effect is proportional
    to them: what it would leave then is predicted.
    """
    baseline = objective.baseline_residual
    points_tried = [(point, objective(point)) for point in points]
    predicted: list[tuple[float, F]] = []
    for point, residual in points_tried if objective.magnitudes else ():
        signature = baseline - residual
        size, along = float(signature @ signature), float(signature @ baseline)
        if size > 0.0 and along != size:
            scaled = point.copy()
            for k, neutral in objective.magnitudes.items():
                scaled[k] = neutral + along / size * (scaled[k] - neutral)
            left = float(baseline @ baseline) - along**2 / size
            predicted.append((left, np.clip(scaled, *bounds(objective.effects, point))))
    promising = sorted(predicted, key=lambda pair: pair[0])[:MAX_SCALED_STARTS]
    points_tried += [(scaled, objective(scaled)) for _, scaled in promising]
    return min(points_tried, key=lambda pair: float(pair[1] @ pair[1]))


def _fit_from(objective: _Objective, searched: F, residual: F) -> EffectFit:
    """Return the fit that is reached from `searched` (p,), where the residual is `residual` (r,).

    A parameter that ends at the bound of its usual range is fitted once more, within all that is plausible.
    """
    evidence, effects = objective.evidence, objective.effects
    goal = _Objective(evidence, effects, searched)
    searched, residual, jacobian = _minimise(goal, searched, residual)
    low, high = bounds(effects, searched)
    if (low < goal.low).any() or (high > goal.high).any():
        goal = _Objective(evidence, effects, searched)
        searched, residual, jacobian = _minimise(goal, searched, residual)
    unit, left_out = evidence.unit_of_row, residual.copy()
    by_unit = np.tile(searched, (len(evidence.units), 1))
    for k in range(len(evidence.units)):
        out = unit == k
        step = _bounded_step(jacobian[~out], residual[~out], searched, goal.low, goal.high, 1e-6)
        left_out[out] = residual[out] - jacobian[out] @ step
        by_unit[k] += step
    covariance = _covariance(evidence, residual, jacobian)
    return EffectFit(effects, searched, residual, jacobian, left_out, by_unit, covariance)


def _minimise(goal: _Objective, searched: F, residual: F) -> tuple[F, F, F]:
    """Return where Levenberg-Marquardt from `searched` (p,) ends, with the residual (r,) and the Jacobian (r, p).

    The last step is too small to change the Jacobian, so that it is not computed again.
    """
    jacobian = goal.jacobian(searched, residual)
    damping, whole = 1e-3, float(goal.baseline_residual @ goal.baseline_residual)
    for _ in range(ITERATIONS):
        before = float(residual @ residual)
        moved, moved_residual, damping = _descend(goal, searched, residual, jacobian, damping)
        if moved_residual is None:
            break
        searched, residual = moved, moved_residual
        after = float(residual @ residual)
        if before - after < MIN_GAIN * whole:
            break
        jacobian = goal.jacobian(searched, residual)
        if whole - after < MIN_EXPLAINED * whole:
            break
    return searched, residual, jacobian


def _descend(goal: _Objective, searched: F, residual: F, jacobian: F, damping: float) -> tuple[F, F | None, float]:
    """Return a better point, its residual and the next damping; no residual if no better point exists."""
    for _ in range(4):
        step = _bounded_step(jacobian, residual, searched, goal.low, goal.high, damping)
        moved = np.clip(searched + step, goal.low, goal.high)
        moved_residual = goal(moved)
        if moved_residual @ moved_residual < residual @ residual:
            return moved, moved_residual, max(damping / 10.0, 1e-9)
        damping = max(damping, 1e-3) * 10.0
    return searched, None, damping


def _bounded_step(jacobian: F, residual: F, at: F, low: F, high: F, damping: float) -> F:
    """Return the damped Gauss-Newton step (p,); parameters that would leave their bounds stop there.

    Parameters differ by many orders of magnitude (metres and newtons per metre), so columns are scaled to unit norm.
    """
    size = column_norms(jacobian)
    scaled = jacobian / size
    gram, slope = scaled.T @ scaled, scaled.T @ residual
    free = np.ones(len(at), bool)
    step = np.zeros(len(at))
    for _ in range(len(at)):
        inside = np.flatnonzero(free)
        if not len(inside):
            break
        block = gram[np.ix_(inside, inside)] + (damping + 1e-12) * np.eye(len(inside))
        fixed = np.flatnonzero(~free)
        right = slope[inside] - gram[np.ix_(inside, fixed)] @ (size * step)[fixed]
        step[inside] = np.linalg.lstsq(block, right, rcond=None)[0] / size[inside]
        beyond = free & ((at + step < low) | (at + step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(at + step, low, high)[beyond] - at[beyond]
        free &= ~beyond
    return step


def _covariance(evidence: Evidence, residual: F, jacobian: F) -> F:
    """Return the sandwich covariance (p, p), clustered by blocks (Liang and Zeger 1986)."""
    block = evidence.block_of_row
    scores = np.zeros((int(block[-1]) + 1, jacobian.shape[1]))
    np.add.at(scores, block, jacobian * residual[:, None])
    size = column_norms(jacobian)
    scaled = jacobian / size
    bread = np.linalg.pinv(scaled.T @ scaled + 1e-12 * np.eye(len(size))) / np.outer(size, size)
    covariance = np.asarray(bread @ (scores.T @ scores) @ bread)
    blind = np.flatnonzero(np.linalg.norm(jacobian, axis=0) == 0.0)
    covariance[blind, blind] = np.inf  # a parameter without any influence is unknown
    return covariance


def column_norms(jacobian: F) -> F:
    """Return the norms of the columns (p,), 1 for zero columns."""
    size = np.linalg.norm(jacobian, axis=0)
    return np.where(size > 0.0, size, 1.0)


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its 95 % interval (SI).

    `at_bound` if it is on a bound of all that is plausible, `drifts` if folds disagree.
    """

    name: str
    value: float
    ci95: Interval
    at_bound: bool = False
    drifts: bool = False
    default: float = float("nan")  # of a parameter of the simulation


def estimate_parameters(fit: EffectFit) -> tuple[tuple[Estimate, ...], ...]:
    """Return the parameters of each effect with intervals in SI units."""
    low, high = bounds(fit.effects)
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0) + _misfit_variance(fit))
    rows = zip(fit.searched.tolist(), errors.tolist(), low, high, _unit_disagreement(fit), strict=True)
    return tuple(tuple(_estimate(p, *next(rows)) for p in effect.parameters) for effect in fit.effects)


def _misfit_variance(fit: EffectFit) -> F:
    """Return the variance (p,) that the rest of the gap adds to the parameters.

    What the effects leave beyond the noise is no noise: errors of forms and simulation are the same in every block. A
    share of their RMS is assumed to lie along each parameter's signature, where no residual shows it
    (`SearchLimits.MISFIT_ALIGNED`).
    """
    left = max(float(fit.residual @ fit.residual) - len(fit.residual), 0.0)
    size = column_norms(fit.jacobian)
    scaled = fit.jacobian / size
    unit = np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=1e-9)) / size**2
    return np.asarray(SearchLimits.MISFIT_ALIGNED**2 * left * np.maximum(unit, 0.0))


def count_stuck_parameters(fit: EffectFit) -> int:
    """Return how many parameters are on a bound other than their neutral value."""
    return sum(e.at_bound for effect in estimate_parameters(fit) for e in effect)


def _unit_disagreement(fit: EffectFit) -> F:
    return np.asarray(np.abs(fit.by_unit - fit.searched).max(axis=0) * np.sqrt(max(len(fit.by_unit) - 1, 1)))


def _estimate(
    parameter: EffectParameter, searched: float, error: float, low: float, high: float, disagreement: float
) -> Estimate:
    ends = sorted(parameter.to_value(searched + sign * Z95 * error) for sign in (-1.0, 1.0))
    near = SearchLimits.NEAR_BOUND * (high - low)
    neutral = parameter.to_search(parameter.neutral) if parameter.scale != "log" else np.nan
    at_bound = bool((searched - low < near or high - searched < near) and not abs(searched - neutral) < near)
    drifts = bool(disagreement > SearchLimits.DRIFT * max(error, 1e-12))
    return Estimate(parameter.name, parameter.to_value(searched), (ends[0], ends[1]), at_bound, drifts)
