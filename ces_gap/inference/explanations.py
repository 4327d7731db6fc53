"""From fits to explanations: parameters with intervals, and what each leaves on recordings the fit never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.effects.effect import Composition, EffectParameter
from ces_gap.inference.anchored_surrogate import needs_rerun
from ces_gap.inference.explanation import Estimate, Explanation, Interval
from ces_gap.inference.fit import NEAR_BOUND, EffectFit, bounds
from ces_gap.inference.shrinkage import Blocks

F = NDArray[np.float64]

DRIFT = 4.0  # standard errors by which units may disagree before a parameter counts as drifting
Z95 = 1.96


@dataclass(frozen=True)
class HeldOutScorer:
    """Held-out recordings cut into `blocks`, with plants prepared for each: `quick` ones, and the `exact` ones."""

    blocks: Blocks
    quick: tuple[Plant, ...]
    exact: tuple[Plant, ...]
    alone: tuple[F, ...]  # the plant's force on each held-out trace
    before: F  # energy of the gap as given in each block

    def forces(self, fit: EffectFit, exactly: bool) -> tuple[F, ...]:
        """Return the force [N] with the effects of a fit on each held-out trace."""
        plants = self.exact if exactly or not needs_rerun(fit.effects) else self.quick
        rows = zip(plants, self.blocks.traces, self.alone, strict=True)
        return tuple(plant.with_effects(fit.composition, trace, alone) for plant, trace, alone in rows)

    def explain(self, fit: EffectFit, forces: Sequence[F]) -> Explanation:
        """Return the fit with what its `forces` [N] leave."""
        forms = tuple(e.form for e in fit.effects)
        return Explanation(fit.names, forms, fit.composition, estimate_parameters(fit), *self._left(forces))

    def nothing(self) -> Explanation:
        """Return the explanation by no effect: what the correction alone leaves."""
        return Explanation((), (), Composition(), (), *self._left(self.alone))

    def _left(self, forces: Sequence[F]) -> tuple[float, float, Interval]:
        """Return the gap after [N], the shrink and its interval."""
        after = self.blocks.energy(forces)
        return self.blocks.rms(after)[0], *self.blocks.shrink(self.before, after)


def build_scorer(blocks: Blocks, plant: Plant, exact: TraceSimulator) -> HeldOutScorer:
    """Return the scorer of some held-out blocks for a plant, whose simulation `exact` reruns best."""
    quick = tuple(plant.prepare_for(t) for t in blocks.traces)
    best = tuple(replace(plant, simulation=exact).prepare_for(t) for t in blocks.traces)
    alone = tuple(plant.alone(t) for t in blocks.traces)
    return HeldOutScorer(blocks, quick, best, alone, blocks.energy([t.simulated_as_logged for t in blocks.traces]))


def estimate_parameters(fit: EffectFit) -> tuple[tuple[Estimate, ...], ...]:
    """Return the parameters of each effect with intervals in SI units."""
    low, high = bounds(fit.effects)
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    units = len(fit.by_unit)
    drift = np.abs(fit.by_unit - fit.searched).max(axis=0) * np.sqrt(max(units - 1, 1))
    made, first = [], 0
    for effect in fit.effects:
        some = []
        for k, parameter in enumerate(effect.parameters, start=first):
            u, e = float(fit.searched[k]), float(spread[k])
            stuck = _is_at_bound(parameter, u, low[k], high[k])
            some.append(_estimate(parameter, u, e, stuck, bool(drift[k] > DRIFT * max(e, 1e-12))))
        first += len(effect.parameters)
        made.append(tuple(some))
    return tuple(made)


def count_stuck_parameters(fit: EffectFit) -> int:
    """Return how many parameters stick to a bound other than their neutral value."""
    return sum(e.at_bound for effect in estimate_parameters(fit) for e in effect)


def measure_parameter_drift(fit: EffectFit) -> float:
    """Return the largest disagreement of units on a parameter in standard errors."""
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-30))
    apart = np.abs(fit.by_unit - fit.searched).max(axis=0) * np.sqrt(max(len(fit.by_unit) - 1, 1))
    return float(np.max(apart / spread)) if len(spread) else 0.0


def _is_at_bound(parameter: EffectParameter, searched: float, low: float, high: float) -> bool:
    near = NEAR_BOUND * (high - low)
    neutral = parameter.to_search(parameter.neutral) if parameter.scale != "log" else np.nan
    return bool((searched - low < near or high - searched < near) and not abs(searched - neutral) < near)


def _estimate(parameter: EffectParameter, searched: float, error: float, at_bound: bool, drifts: bool) -> Estimate:
    ends = sorted(parameter.to_value(searched + sign * Z95 * error) for sign in (-1.0, 1.0))
    return Estimate(parameter.name, parameter.to_value(searched), (ends[0], ends[1]), at_bound, drifts)
