"""Comparing explanations by the residuals of units left out, block against block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ces_gap.evidence import Evidence

F = NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """By how much one residual's squares are below another's (`energy`, whitened), and the standard `error` of that."""

    energy: float
    error: float

    @property
    def z(self) -> float:
        """Energy over its error."""
        return self.energy / max(self.error, 1e-12)


def gain(evidence: Evidence, worse: F, better: F) -> Gain:
    """Return the paired gain of whitened residual `better` (r,) over `worse` (r,); blocks are the samples."""
    by_block = np.bincount(evidence.block_of_row, worse**2 - better**2)
    count = len(by_block)
    return Gain(float(by_block.sum()), float(by_block.std(ddof=1) * np.sqrt(count)) if count > 1 else float("inf"))
