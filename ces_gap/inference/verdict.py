"""The verdict and its probabilities, from figures that mean the same on every plant.

The probabilities are those of a logistic model of these figures, fitted to cases on a plant unlike those it is judged
on (calibration.json says which). Margins of likelihood are no probabilities: no form is exactly what is there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"
POSSIBLE = 0.1  # probability from which an effect that is not named makes a verdict ambiguous
NEGLIGIBLE_SHARE = 0.01  # of the gap's energy: unexplained shares below this are alike


@dataclass(frozen=True)
class VerdictFigures:
    """What decides. Shares are of the gap's energy above the noise, whitened, on units left out.

    `energy` is that energy over the noise's; `gain_z` the best explanation's gain over its error; `ceiling_z` that of
    the generic learner's. `unexplained` is what the best explanation leaves, `learnable` what the learner still finds
    in that (both the same where the noise is not known), `learnable_z` over its error. `stuck` counts parameters at a
    bound, `drift` is how far units disagree on parameters, in standard errors.
    """

    energy: float
    gain_z: float
    ceiling_z: float
    unexplained: float
    learnable: float
    learnable_z: float
    stuck: int
    drift: float


@dataclass(frozen=True)
class Calibration:
    """Weights of the logistic model: `gap` of `gap_features`, `unknown` of `unknown_features`; `sharpness` of choice.

    Below `least_gap`, the probability of a gap, there is none; below `least_known`, that of a known effect, unknown.
    """

    gap: tuple[float, ...]
    unknown: tuple[float, ...]
    sharpness: float
    least_gap: float
    least_known: float


@dataclass(frozen=True)
class Probabilities:
    """Of no gap, of something unknown, and of each effect by name; they sum to 1."""

    none: float
    unknown: float
    effects: Mapping[str, float]


def calibration() -> Calibration:
    """Return the weights that come with the package."""
    given = json.loads((files("ces_gap.inference") / "calibration.json").read_text(encoding="utf-8"))
    gap, unknown = (tuple(map(float, given[name])) for name in ("gap", "unknown"))
    return Calibration(gap, unknown, *(float(given[name]) for name in ("sharpness", "least_gap", "least_known")))


def gap_features(figures: VerdictFigures) -> F:
    """Return what the probability of a gap is made of."""
    z = max(figures.gain_z, figures.ceiling_z, figures.energy, 0.1)  # a gap above a known noise needs no explanation
    return np.array([1.0, np.log(max(figures.energy, 1e-3)), np.log(z)])


def unknown_features(figures: VerdictFigures) -> F:
    """Return what the probability of something unknown is made of."""
    share = float(np.clip(figures.unexplained, NEGLIGIBLE_SHARE, 2.0))
    return np.array([1.0, np.log(share), float(np.clip(figures.learnable, 0.0, 1.0)), float(figures.stuck > 0)])


def probabilities(
    figures: VerdictFigures, unexplained: Mapping[str, float], composition: Sequence[str], weights: Calibration
) -> Probabilities:
    """Return the probabilities, given what each effect leaves unexplained and which compose the best one.

    An effect leaves what it leaves alone, or less in the place of one of the best (`rivals.min_unexplained_shares`).
    """
    none = 1.0 - _logistic(gap_features(figures) @ np.array(weights.gap))
    unknown = (1.0 - none) * _logistic(unknown_features(figures) @ np.array(weights.unknown))
    names = list(unexplained)
    left = np.log(np.maximum(np.array([unexplained[n] for n in names]), 0.0) + NEGLIGIBLE_SHARE)
    left[[n in composition for n in names]] = min(np.log(max(figures.unexplained, 0.0) + NEGLIGIBLE_SHARE), left.min())
    share = np.exp(-weights.sharpness * (left - left.min()))
    share *= (1.0 - none - unknown) / share.sum()
    return Probabilities(none, unknown, dict(zip(names, share.tolist(), strict=True)))


def has_alternatives(named: Sequence[str], odds: Probabilities) -> bool:
    """Return True if an effect that is not named is possible, too."""
    return any(p >= POSSIBLE for name, p in odds.effects.items() if name not in named)


def _logistic(value: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(value, -50.0, 50.0))))
