"""Holm's correction for several tests at once (Scandinavian Journal of Statistics 6, 1979)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def adjusted_p_values(p_values: Sequence[float]) -> list[float]:
    """Return Holm's adjusted p-values, in the same order: a test is significant at a level if its value is below it."""
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[int(i)] = largest
    return adjusted


def step_levels(p_values: Sequence[float], alpha: float) -> list[float]:
    """Return for each test the significance level of Holm's step that decided it.

    An interval of 1 - that level excludes zero exactly if Holm's procedure at `alpha` calls the test significant: after
    the first test that is not, all further ones share its level.
    """
    levels, level, going = [alpha] * len(p_values), alpha, True
    for rank, i in enumerate(np.argsort(p_values, kind="stable")):
        if going:
            level = alpha / (len(p_values) - rank)
            going = p_values[i] < level
        levels[int(i)] = level
    return levels
