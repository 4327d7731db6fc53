"""From fits to explanations: parameters with intervals, and what each leaves on recordings the fit never saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Plant, Rerun
from ces_gap.diagnosis import Estimate, Explained
from ces_gap.effects.effect import Composition, Parameter
from ces_gap.inference.anchored import reruns
from ces_gap.inference.fit import NEAR_BOUND, Fit, bounds
from ces_gap.inference.shrinkage import Blocks

F = NDArray[np.float64]

DRIFT = 4.0  # standard errors by which units may disagree before a parameter counts as drifting
Z95 = 1.96


@dataclass(frozen=True)
class Judge:
    """Held-out recordings cut into `blocks`; `quick` stands in for `exact` where a fit is not asked for exactly."""

    blocks: Blocks
    quick: Plant
    exact: Plant
    alone: tuple[F, ...]  # the plant's force on each held-out trace
    before: F  # energy of the gap as given in each block

    def forces(self, composition: Composition, exactly: bool) -> list[F]:
        """Return the force [N] with effects on each held-out trace."""
        plant = self.exact if exactly else self.quick
        pairs = zip(self.blocks.traces, self.alone, strict=True)
        return [plant.with_effects(composition, trace, alone) for trace, alone in pairs]

    def explained(self, fit: Fit, gain: float, gain_error: float, exactly: bool) -> Explained:
        """Return the fit with what it leaves."""
        after = self.blocks.energy(self.forces(fit.composition, exactly or not reruns(fit.effects)))
        left, (shrink, ci95) = self.blocks.rms(after)[0], self.blocks.shrink(self.before, after)
        return Explained(
            effects=fit.names,
            forms=tuple(e.form for e in fit.effects),
            composition=fit.composition,
            estimates=estimates(fit),
            gap_after_N=left,
            shrink=shrink,
            shrink_ci95=ci95,
            gain=gain,
            gain_error=gain_error,
        )

    def nothing(self) -> Explained:
        """Return the explanation by no effect: what the correction alone leaves."""
        after = self.blocks.energy(self.alone)
        shrink, ci95 = self.blocks.shrink(self.before, after)
        return Explained((), (), Composition(), (), self.blocks.rms(after)[0], shrink, ci95)


def judge(blocks: Blocks, cheap: Rerun, exact: Rerun | None, plant: Plant) -> Judge:
    """Return the judge of some held-out blocks."""
    alone = tuple(plant.force(t, t.inputs) for t in blocks.traces)
    before = blocks.energy([t.as_given for t in blocks.traces])
    return Judge(blocks, Plant(cheap, plant.correction), Plant(exact or cheap, plant.correction), alone, before)


def estimates(fit: Fit) -> tuple[tuple[Estimate, ...], ...]:
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
            stuck = _stuck(parameter, u, low[k], high[k])
            some.append(_estimate(parameter, u, e, stuck, bool(drift[k] > DRIFT * max(e, 1e-12))))
        first += len(effect.parameters)
        made.append(tuple(some))
    return tuple(made)


def stuck(fit: Fit) -> int:
    """Return how many parameters stick to a bound other than their neutral value."""
    return sum(e.at_bound for effect in estimates(fit) for e in effect)


def drift(fit: Fit) -> float:
    """Return the largest disagreement of units on a parameter in standard errors."""
    spread = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-30))
    apart = np.abs(fit.by_unit - fit.searched).max(axis=0) * np.sqrt(max(len(fit.by_unit) - 1, 1))
    return float(np.max(apart / spread)) if len(spread) else 0.0


def _stuck(parameter: Parameter, searched: float, low: float, high: float) -> bool:
    near = NEAR_BOUND * (high - low)
    neutral = parameter.to_search(parameter.neutral) if parameter.scale != "log" else np.nan
    return bool((searched - low < near or high - searched < near) and not abs(searched - neutral) < near)


def _estimate(parameter: Parameter, searched: float, error: float, at_bound: bool, drifts: bool) -> Estimate:
    ends = sorted(parameter.to_value(searched + sign * Z95 * error) for sign in (-1.0, 1.0))
    return Estimate(parameter.name, parameter.to_value(searched), (ends[0], ends[1]), at_bound, drifts)
