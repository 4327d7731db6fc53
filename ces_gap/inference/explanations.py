"""From fits to explanations: parameters with intervals, and the gap that each fit leaves on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.effects.effect import Composition, EffectParameter
from ces_gap.inference.anchored_surrogate import needs_rerun
from ces_gap.inference.explanation import Estimate, Explanation, Interval
from ces_gap.inference.fit import NEAR_BOUND, EffectFit, bounds
from ces_gap.inference.shrinkage import Blocks
from ces_gap.trace import F

DRIFT = 4.0  # standard errors: units that disagree by more make a parameter drift
Z95 = 1.96
MISFIT_ALIGNED = 0.25


@dataclass(frozen=True)
class HeldOutScorer:
    """Held-out recordings in `blocks`, with plants prepared for each: `quick` and `exact` ones."""

    blocks: Blocks
    quick: tuple[Plant, ...]
    exact: tuple[Plant, ...]
    alone: tuple[F, ...]  # the plant's force on each held-out trace
    before: F  # energy in each block of the gap of the original simulation

    def forces(self, fit: EffectFit, exact: bool) -> tuple[F, ...]:
        """Return the force [N] with the effects of a fit on each held-out trace."""
        plants = self.exact if exact or not needs_rerun(fit.effects) else self.quick
        rows = zip(plants, self.blocks.traces, self.alone, strict=True)
        return tuple(plant.with_effects(fit.composition, trace, alone) for plant, trace, alone in rows)

    def explain(self, fit: EffectFit, forces: Sequence[F]) -> Explanation:
        """Return the explanation by a fit whose `forces` [N] are known."""
        forms = tuple(e.form for e in fit.effects)
        return Explanation(fit.names, forms, fit.composition, estimate_parameters(fit), *self._score(forces))

    def nothing(self) -> Explanation:
        """Return the explanation by no effect: the gap that the correction alone leaves."""
        return Explanation((), (), Composition(), (), *self._score(self.alone))

    def _score(self, forces: Sequence[F]) -> tuple[float, float, Interval]:
        """Return the gap after [N], the shrink and its interval."""
        after = self.blocks.energy(forces)
        return self.blocks.rms(after)[0], *self.blocks.shrink(self.before, after)


def build_scorer(blocks: Blocks, plant: Plant, exact: TraceSimulator) -> HeldOutScorer:
    """Return the scorer of held-out blocks for a plant; `exact` is the simulation with which effects rerun exactly."""
    quick = tuple(plant.prepare_for(t) for t in blocks.traces)
    best = tuple(replace(plant, simulation=exact).prepare_for(t) for t in blocks.traces)
    alone = tuple(plant.alone(t) for t in blocks.traces)
    return HeldOutScorer(blocks, quick, best, alone, blocks.energy([t.simulated_as_logged for t in blocks.traces]))


def estimate_parameters(fit: EffectFit) -> tuple[tuple[Estimate, ...], ...]:
    """Return the parameters of each effect with intervals in SI units."""
    low, high = bounds(fit.effects)
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0) + _misfit_variance(fit))
    rows = zip(fit.searched.tolist(), errors.tolist(), low, high, _unit_disagreement(fit), strict=True)
    return tuple(tuple(_estimate(p, *next(rows)) for p in effect.parameters) for effect in fit.effects)


def _misfit_variance(fit: EffectFit) -> F:
    """Return the variance (p,) that the rest of the gap adds to the parameters.

    What the effects leave beyond the noise is no noise: errors of forms and simulation are the same in every block. A
    share of their RMS, `MISFIT_ALIGNED`, is assumed to lie along each parameter's signature, where no residual shows it
    (Brynjarsdottir and O'Hagan 2014).
    """
    left = max(float(fit.residual @ fit.residual) - len(fit.residual), 0.0)
    size = np.linalg.norm(fit.jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    scaled = fit.jacobian / size
    unit = np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=1e-9)) / size**2
    return np.asarray(MISFIT_ALIGNED**2 * left * np.maximum(unit, 0.0))


def count_stuck_parameters(fit: EffectFit) -> int:
    """Return how many parameters are on a bound other than their neutral value."""
    return sum(e.at_bound for effect in estimate_parameters(fit) for e in effect)


def measure_parameter_drift(fit: EffectFit) -> float:
    """Return the largest disagreement between units on a parameter, in standard errors."""
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-30))
    return float(np.max(_unit_disagreement(fit) / spread)) if len(spread) else 0.0


def _unit_disagreement(fit: EffectFit) -> F:
    return np.asarray(np.abs(fit.by_unit - fit.searched).max(axis=0) * np.sqrt(max(len(fit.by_unit) - 1, 1)))


def _is_at_bound(parameter: EffectParameter, searched: float, low: float, high: float) -> bool:
    near = NEAR_BOUND * (high - low)
    neutral = parameter.to_search(parameter.neutral) if parameter.scale != "log" else np.nan
    return bool((searched - low < near or high - searched < near) and not abs(searched - neutral) < near)


def _estimate(
    parameter: EffectParameter, searched: float, error: float, low: float, high: float, disagreement: float
) -> Estimate:
    ends = sorted(parameter.to_value(searched + sign * Z95 * error) for sign in (-1.0, 1.0))
    at_bound = _is_at_bound(parameter, searched, low, high)
    drifts = bool(disagreement > DRIFT * max(error, 1e-12))
    return Estimate(parameter.name, parameter.to_value(searched), (ends[0], ends[1]), at_bound, drifts)
