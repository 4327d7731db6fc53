"""Comparison of explanations by their residuals on units left out, paired by blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.arrays import F
from ces_gap.effects.effect import Effect
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.explanation import count_stuck_parameters
from ces_gap.inference.fit import EffectFit

MIN_GAIN_SHARE = 0.05  # of the gap's energy that another effect must explain
MIN_GAIN_SHARE_UNCORRECTED = (
    0.12  # the same without references: a part that is smaller may be the simulation's own error
)
MIN_GAIN_Z = 2.0
PARAMETER = 0.005  # share of the gap's energy that each parameter costs when effects are ranked
CLEAR_SHARE = 0.1  # of the noise's energy


@dataclass(frozen=True)
class PairedGain:
    """Difference of two residuals' sums of squares (`energy`, whitened), and its standard `error`."""

    energy: float
    error: float

    @property
    def z(self) -> float:
        """Energy over its error."""
        return self.energy / max(self.error, 1e-12)


def compute_paired_gain(evidence: Evidence, worse: F, better: F) -> PairedGain:
    """Return the paired gain of whitened residual `better` (r,) over `worse` (r,); blocks are the samples."""
    by_block = np.bincount(evidence.block_of_row, worse**2 - better**2)
    count = len(by_block)
    error = float(by_block.std(ddof=1) * np.sqrt(count)) if count > 1 else float("inf")
    return PairedGain(float(by_block.sum()), error)


def cost_with_penalty(fit: EffectFit, energy: float) -> float:
    """Return the fit's cost plus a penalty for each parameter, by which explanations of this energy are ranked."""
    count = sum(len(e.parameters) for e in fit.effects if e.prior_share == 0.0)
    return fit.cost + PARAMETER * energy * count + prior_cost(fit, energy)


def prior_cost(fit: EffectFit, energy: float) -> float:
    """Return the energy by which flexible maps must explain more than effects."""
    return energy * sum(e.prior_share for e in fit.effects)


def choose_best_fit(evidence: Evidence, fits: Sequence[EffectFit], energy: float) -> EffectFit:
    """Return the best fit of a gap of this energy; more parameters must pay their penalty or gain significantly."""
    best, *others = sorted(fits, key=lambda f: (len(f.searched), f.cost))
    for fit in others:
        if cost_with_penalty(fit, energy) < cost_with_penalty(best, energy) or (
            len(fit.searched) > len(best.searched)
            and is_worthwhile(evidence, best.left_out, fit, prior_cost(fit, energy) - prior_cost(best, energy))
        ):
            best = fit
    return best


def is_worthwhile(evidence: Evidence, before: F, after: EffectFit, min_energy: float) -> bool:
    """True if the fit gains more than `min_energy`, and more than twice its error or than noise could explain.

    A gain confined to a few blocks, as at a bump stop, has a large error between blocks however clear it is.
    """
    paired = compute_paired_gain(evidence, before, after.left_out)
    return paired.energy > min_energy and (paired.z > MIN_GAIN_Z or paired.energy > CLEAR_SHARE * len(before))


def loses_to_nested_form(evidence: Evidence, fit: EffectFit, other: EffectFit) -> bool:
    """True if two fits differ in an effect and its limit only, and the data decide for the `other`.

    The form must gain more than twice the error of its gain over the limit. The limit wins if the form's best
    parameters are on a bound, where the form is no longer plausible, or if it leaves less by more than twice the error.
    """
    mine, theirs = _differing_effects(fit, other), _differing_effects(other, fit)
    if len(mine) != 1 or len(theirs) != 1:
        return False
    better = compute_paired_gain(evidence, fit.left_out, other.left_out).z > MIN_GAIN_Z
    if theirs[0].limit == mine[0].name:
        return better
    return mine[0].limit == theirs[0].name and (better or count_stuck_parameters(fit) > 0)


def order_nested_forms(evidence: Evidence, ranked: Sequence[EffectFit]) -> tuple[EffectFit, ...]:
    """Return the fits of single effects, best first, each before those that lose to it as a nested form."""
    ordered: list[EffectFit] = []
    for fit in ranked:
        place = [k for k, earlier in enumerate(ordered) if loses_to_nested_form(evidence, earlier, fit)]
        ordered.insert(place[0] if place else len(ordered), fit)
    return tuple(ordered)


def _differing_effects(fit: EffectFit, other: EffectFit) -> list[Effect]:
    return [effect for effect in fit.effects if effect.name not in other.names]
