"""The verdict and its probabilities, from figures that are comparable between plants.

The probabilities come from a logistic model of these figures. It was calibrated on cases of a plant unlike those of its
evaluation (`calibration.json` names them). Likelihoods would not do as probabilities: no form is exactly true.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from ces_data.arrays import F

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"
POSSIBLE = 0.1  # probability at which an effect outside the composition makes the verdict ambiguous
CALIBRATION, TIMING = "calibration", "simulation_timing"
NEGLIGIBLE_SHARE = 0.01  # of the gap's energy: smaller unexplained shares are not distinguished


@dataclass(frozen=True)
class VerdictFigures:
    """The basis of the verdict: whitened energies on units left out, as shares of the gap's energy above the noise.

    `energy` is the gap's energy over the noise's. `gain_z` and `ceiling_z` are the gains of the best explanation and of
    the generic learner over their standard errors. `unexplained` is the share that the best explanation leaves,
    `learnable` the part of it that the learner explains (equal if the noise is unknown), `learnable_z` over its
    standard error. `stuck` counts parameters on a bound; `drift` is the largest disagreement between units on a
    parameter, in standard errors.
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
    """Weights of the logistic model for `gap_features` and `unknown_features`, and `sharpness` of the choice of effect.

    The verdict is "no_gap" if the probability of a gap is below `least_gap`, "unknown" if that of a known effect is
    below `least_known`.
    """

    gap: tuple[float, ...]
    unknown: tuple[float, ...]
    sharpness: float
    least_gap: float
    least_known: float


@dataclass(frozen=True)
class Probabilities:
    """Probabilities of no gap, of an unknown cause and of each effect by name; they sum to 1."""

    none: float
    unknown: float
    effects: Mapping[str, float]


def calibration(mode: str = "references") -> Calibration:
    """Return the weights of a mode from `calibration.json`.

    Modes are "references" and "no_references" for a simulation that is run, "predictions" for recorded ones, and
    "identified" for a model identified from the references.
    """
    weights = json.loads((files("ces_gap.inference") / "calibration.json").read_text(encoding="utf-8"))[mode]
    gap, unknown = (tuple(map(float, weights[name])) for name in ("gap", "unknown"))
    return Calibration(gap, unknown, *(float(weights[name]) for name in ("sharpness", "least_gap", "least_known")))


def gap_features(figures: VerdictFigures) -> F:
    """Return the features of the probability of a gap."""
    z = max(figures.gain_z, figures.ceiling_z, figures.energy, 0.1)  # a large gap needs no explanation
    return np.array([1.0, np.log(max(figures.energy, 1e-3)), np.log(z)])


def unknown_features(figures: VerdictFigures) -> F:
    """Return the features of the probability of an unknown cause."""
    share = float(np.clip(figures.unexplained, NEGLIGIBLE_SHARE, 2.0))
    return np.array([1.0, np.log(share), float(np.clip(figures.learnable, 0.0, 1.0)), float(figures.stuck > 0)])


def probabilities(
    figures: VerdictFigures, unexplained: Mapping[str, float], composition: Sequence[str], weights: Calibration
) -> Probabilities:
    """Return the probabilities from the share that each effect leaves unexplained (`min_unexplained_shares`).

    The effects of the best `composition` count as leaving what the composition leaves.
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
    """True if an effect that is not named is possible, too.

    A recalibration can absorb a part of any effect; an effect that explains as much with less stands against it.
    """
    return any(p >= POSSIBLE for name, p in odds.effects.items() if name not in (*named, CALIBRATION))


def _logistic(value: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(value, -50.0, 50.0))))
