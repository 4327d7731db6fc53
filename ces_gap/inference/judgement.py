"""The odds of no gap, of an unknown cause and of each effect; the numbers that a verdict follows from, and the verdict.

The odds come from a logistic model of figures that are comparable between plants. It was calibrated on cases of a plant
unlike those of its evaluation (`calibration.json` names them). Likelihoods would not do as probabilities: no form is
exactly true.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from ces_data.arrays import F
from ces_gap.inference.fit import Z95
from ces_gap.limits import SearchLimits

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"
CALIBRATION, TIMING, PARAMETERS = "calibration", "simulation_timing", "parameters"  # errors of the simulation itself


class Within:
    """What a gap that is none lies within."""

    TOLERANCE, NOISE, TIMING, BASELINE_ERROR = "tolerance", "noise", "timing", "baseline_error"


class Doubt:
    """What keeps a cause from being named."""

    ALTERNATIVES, SIMULATION_ERROR, REMAINS = "alternatives", "simulation_error", "remains"
    NOT_CONFIRMED, UNDETERMINED, LEAVES_MORE = "not_confirmed", "undetermined", "leaves_more"
    UNCERTAIN = "uncertain"


MIN_PROBABILITY = 1e-12  # of a cause that was found, so that shares of it are defined


@dataclass(frozen=True)
class VerdictFigures:
    """The basis of the verdict: whitened energies on units left out, as shares of the gap's energy above the noise.

    `energy` is the gap's energy over the noise's. `gain_z` and `ceiling_z` are the gains of the best explanation and of
    the generic learner over their standard errors. `unexplained` is the share that the best explanation leaves,
    `learnable` the part of it that the learner explains (equal if the noise is unknown). `stuck` counts parameters on a
    bound.
    """

    energy: float
    gain_z: float
    ceiling_z: float
    unexplained: float
    learnable: float
    stuck: int


@dataclass(frozen=True)
class OddsWeights:
    """Weights of the logistic model for `gap_features` and `unknown_features`, and `sharpness` of the choice of effect.

    A cause is named only if the probability of a gap is at least `least_gap`, and that of a known effect in a gap at
    least `least_known`.
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

    @property
    def known(self) -> float:
        """The probability that any of the effects is the cause."""
        return sum(self.effects.values())

    @property
    def known_given_gap(self) -> float:
        """The same if there is a gap."""
        return self.known / max(self.known + self.unknown, 1e-300)

    def normalise(self, causes: Sequence[str]) -> Probabilities:
        """Return them finite and with a sum of 1, each of the `causes` above 0; unknown ones count as 0."""

        def known(probability: float) -> float:
            return min(max(probability, 0.0), 1.0) if math.isfinite(probability) else 0.0

        none, unknown = known(self.none), known(self.unknown)
        effects = {name: known(self.effects.get(name, 0.0)) for name in dict.fromkeys((*self.effects, *causes))}
        effects |= {name: max(effects[name], MIN_PROBABILITY) for name in causes}
        total = none + unknown + sum(effects.values())
        if total <= 0.0:
            return Probabilities(0.0, 1.0, effects)
        return Probabilities(none / total, unknown / total, {name: p / total for name, p in effects.items()})

    def with_none(self, none: float) -> Probabilities:
        """Return them with another probability of no gap; the others keep their proportions."""
        gap = self.known + self.unknown
        if gap < 1e-300:  # a share of it could overflow
            return Probabilities(none, 1.0 - none, self.effects)
        none = min(none, 1.0 - MIN_PROBABILITY)  # so that the others can grow again
        share = (1.0 - none) / gap
        return Probabilities(none, self.unknown * share, {name: p * share for name, p in self.effects.items()})

    def with_unknown(self, unknown: float) -> Probabilities:
        """Return them with another probability of an unknown cause; the effects get the difference, in proportion."""
        known = self.known
        if known <= 0.0:
            return self
        share = max(known + self.unknown - unknown, 0.0) / known
        return Probabilities(self.none, unknown, {name: p * share for name, p in self.effects.items()})


@dataclass(frozen=True)
class GapSize:
    """The gap on some recordings, RMS [N]: without noise, and after the simulation's timing was fitted as well.

    `noise_N` is that of the force as logged; where it is not `noise_known`, no source limits this guess. `own_error_N`
    is the error that the simulation may have here, as it says itself (0 if it does not).
    """

    gap_N: float
    timed_N: float
    noise_N: float
    noise_known: bool = True
    own_error_N: float = 0.0


@dataclass(frozen=True)
class ClosedShare:
    """The share of the held-out gap's energy that an explanation closes, with the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    def probability_above(self, share: float) -> float:
        """Return the probability that the true share is above `share`; 0 if nothing is known."""
        return probability_below(-self.value, -share, self.high - self.low)


def probability_below(value: float, limit: float, width: float) -> float:
    """Return the probability that a quantity measured as `value` is below `limit`; its 95 % interval is `width` wide.

    The error is taken as normal. An unknown value is not below anything.
    """
    if math.isnan(value) or math.isnan(limit):
        return 0.0
    error = width / (2.0 * Z95) if 0.0 < width < math.inf else 0.0
    if error > 0.0 and math.isfinite(limit - value):
        return 0.5 * math.erfc((value - limit) / error / math.sqrt(2.0))
    return float(value <= limit)


@dataclass(frozen=True)
class SearchFindings:
    """What the search found on the fitted recordings, as numbers.

    `rest_N` is the RMS [N] that the best explanation and the generic learner leave; an effect below `visible_from_N`
    would hide behind noise and the simulation's own error. `interchangeable` are groups, `absorbed` the effects that a
    recalibration would imitate. The best explanation `is_map` if it holds errors of the simulation's map only. It may
    leave the share `twin_error` of the gap's energy because of a twin that replaces the simulation, which `is_recorded`
    if only its predictions are known.
    """

    figures: VerdictFigures
    odds: Probabilities
    weights: OddsWeights
    size: GapSize
    rest_N: float
    visible_from_N: float
    tolerance_N: float
    has_references: bool
    interchangeable: tuple[tuple[str, ...], ...]
    absorbed: tuple[str, ...]
    is_map: bool
    twin_error: float = 0.0
    is_recorded: bool = False


@dataclass(frozen=True)
class VerdictEvidence:
    """All that a verdict follows from, as plain numbers; any of them may be unknown (NaN).

    On held-out recordings the gap has a size with an interval, and noise of `in_band_N` in its band; the composition
    has `closed` a share of it, each effect alone another, the generic learner the share `learnt`. The composition
    `is_undetermined` if one of its effects may have no size. A gap `is_rare` if a short deviation stands out,
    and the composition `leaves_rare` if one stands out beyond it.
    """

    search: SearchFindings
    held_out: GapSize
    held_out_ci95_N: tuple[float, float]
    composition: tuple[str, ...]
    closed: ClosedShare
    closed_alone: Mapping[str, ClosedShare]
    learnt: float
    is_undetermined: bool = False
    in_band_N: float = 0.0
    is_rare: bool = False
    leaves_rare: bool = False

    @property
    def sizes(self) -> tuple[GapSize, GapSize]:
        """The gap on the fitted and on the held-out recordings."""
        return self.search.size, self.held_out

    @property
    def may_be_own_error(self) -> bool:
        """True if the gap is not above the error that the simulation says it may have."""
        return not self.search.has_references and all(0.0 < s.own_error_N >= s.gap_N for s in self.sizes)


@dataclass(frozen=True)
class Judgement:
    """The verdict with its probabilities, the `reason` for "no_gap", and what keeps a cause from being named: `doubt`.

    `alternatives` are the effects outside the composition that stay possible, for "ambiguous"; `ties` are groups of
    effects that the recordings cannot distinguish.
    """

    verdict: str
    probabilities: Probabilities
    reason: str = ""
    doubt: str = ""
    alternatives: tuple[str, ...] = ()
    ties: tuple[tuple[str, ...], ...] = ()


def calibration(mode: str = "references") -> OddsWeights:
    """Return the weights of a mode from `calibration.json`.

    Modes are "references" and "no_references" for a simulation that is run, "predictions" for recorded ones, and
    "identified" for a model identified from the references.
    """
    weights = json.loads((files("ces_gap.inference") / "calibration.json").read_text(encoding="utf-8"))[mode]
    gap, unknown = (tuple(map(float, weights[name])) for name in ("gap", "unknown"))
    return OddsWeights(gap, unknown, *(float(weights[name]) for name in ("sharpness", "least_gap", "least_known")))


def gap_features(figures: VerdictFigures) -> F:
    """Return the features of the probability of a gap."""
    z = max(figures.gain_z, figures.ceiling_z, figures.energy, 0.1)  # a large gap needs no explanation
    return np.array([1.0, np.log(max(figures.energy, 1e-3)), np.log(z)])


def unknown_features(figures: VerdictFigures) -> F:
    """Return the features of the probability of an unknown cause."""
    share = float(np.clip(figures.unexplained, SearchLimits.NEGLIGIBLE, 2.0))
    return np.array([1.0, np.log(share), float(np.clip(figures.learnable, 0.0, 1.0)), float(figures.stuck > 0)])


def probabilities(
    figures: VerdictFigures,
    unexplained: Mapping[str, float],
    composition: Sequence[str],
    weights: OddsWeights,
    twin_error: float = 0.0,
) -> Probabilities:
    """Return the probabilities from the share that each effect leaves unexplained (`min_unexplained_shares`).

    The effects of the best `composition` count as leaving what the composition leaves. Shares below `twin_error` are
    alike.
    """
    none = 1.0 - _logistic(gap_features(figures) @ np.array(weights.gap))
    unknown = (1.0 - none) * _logistic(unknown_features(figures) @ np.array(weights.unknown))
    names = list(unexplained)
    least = max(twin_error, 0.0)
    left = np.log(np.maximum(np.array([unexplained[n] for n in names]), least) + SearchLimits.NEGLIGIBLE)
    together = np.log(max(figures.unexplained, least) + SearchLimits.NEGLIGIBLE)
    left[[n in composition for n in names]] = min(together, left.min())
    share = np.exp(-weights.sharpness * (left - left.min()))
    share *= (1.0 - none - unknown) / share.sum()
    return Probabilities(none, unknown, dict(zip(names, share.tolist(), strict=True)))


def _logistic(value: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(value, -50.0, 50.0))))
