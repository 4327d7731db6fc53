"""The records of a verdict: the numbers that it follows from, and what it says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ces_gap.inference.fit import Z95
from ces_gap.inference.odds import OddsWeights, Probabilities, VerdictFigures

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"
CALIBRATION, TIMING, PARAMETERS = "calibration", "simulation_timing", "parameters"  # errors of the simulation itself
WITHIN_TOLERANCE, WITHIN_NOISE, WITHIN_TIMING, WITHIN_BASELINE = "tolerance", "noise", "timing", "baseline_error"
ALTERNATIVES, SIMULATION_ERROR, REMAINS = "alternatives", "simulation_error", "remains"
NOT_CONFIRMED, UNDETERMINED, LEAVES_MORE, UNCERTAIN = "not_confirmed", "undetermined", "leaves_more", "uncertain"


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
