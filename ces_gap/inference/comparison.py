"""Comparing explanations by the residuals of units left out, block against block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit

F = NDArray[np.float64]

MIN_GAIN_SHARE = 0.05  # of the gap's energy that another effect must explain
MIN_GAIN_Z = 2.0
PARAMETER = 0.005  # share of the gap's energy that a parameter must be worth when effects are ranked
CLEAR_SHARE = 0.1  # of the noise's energy


@dataclass(frozen=True)
class PairedGain:
    """By how much one residual's squares are below another's (`energy`, whitened), and the standard `error` of that."""

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
    return PairedGain(
        float(by_block.sum()), float(by_block.std(ddof=1) * np.sqrt(count)) if count > 1 else float("inf")
    )


def cost_with_penalty(fit: EffectFit, energy: float) -> float:
    """Return the fit's cost with its parameters counted, by which explanations of a gap of this energy are ranked."""
    return fit.cost + PARAMETER * energy * len(fit.searched)


def choose_best_fit(evidence: Evidence, fits: Sequence[EffectFit], energy: float) -> EffectFit:
    """Return the fit that explains a gap of this energy best; parameters must be worth it, or their gain be clear."""
    simpler, *others = sorted(fits, key=lambda f: (len(f.searched), f.cost))
    for fit in others:
        if cost_with_penalty(fit, energy) < cost_with_penalty(simpler, energy) or (
            len(fit.searched) > len(simpler.searched) and is_worthwhile(evidence, simpler.left_out, fit, 0.0)
        ):
            simpler = fit
    return simpler


def is_worthwhile(evidence: Evidence, before: F, after: EffectFit, min_energy: float) -> bool:
    """Return True if the fit gains more than `min_energy`, and more than twice its error or so much that noise cannot.

    What happens in a few blocks only, as at a bump stop, has a large error between blocks however clear it is.
    """
    paired = compute_paired_gain(evidence, before, after.left_out)
    return paired.energy > min_energy and (paired.z > MIN_GAIN_Z or paired.energy > CLEAR_SHARE * len(before))
