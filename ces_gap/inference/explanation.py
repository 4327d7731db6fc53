"""Records of explanations: the parameters of effects with intervals, and the gap that they leave."""

from __future__ import annotations

from dataclasses import dataclass

from ces_gap.effects.effect import Composition

Interval = tuple[float, float]


@dataclass(frozen=True)
class Estimate:
    """A parameter's value with its 95 % interval (SI); `at_bound` if it is on a bound, `drifts` if folds disagree."""

    name: str
    value: float
    ci95: Interval
    at_bound: bool = False
    drifts: bool = False


@dataclass(frozen=True)
class Explanation:
    """One or several effects, with gap and shrink on held-out recordings, without measurement noise."""

    effects: tuple[str, ...]
    forms: tuple[str, ...]
    composition: Composition
    estimates: tuple[tuple[Estimate, ...], ...]  # by effect
    gap_after_N: float
    shrink: float
    shrink_ci95: Interval
    gain: float = 0.0  # cross-fitted share of the gap's energy explained on the fitted recordings
    gain_error: float = 0.0
    probability: float = 0.0
