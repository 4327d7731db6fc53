"""The verdict: one pure function of numbers, which also returns the probabilities that a report shows.

`judge` weighs what the search on the fitted recordings (`findings.py`) and the held-out recordings found. Each finding
changes the probabilities, and the verdict follows from them, so that the two cannot contradict each other.

The probabilities of the search are those of `odds.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ces_gap.inference.odds import Calibration, Probabilities, VerdictFigures
from ces_gap.inference.ties import ClosedShare, confirm_ties, probability_below

NAMED, AMBIGUOUS, UNKNOWN, NO_GAP = "named", "ambiguous", "unknown", "no_gap"
CALIBRATION, TIMING = "calibration", "simulation_timing"
WITHIN_TOLERANCE, WITHIN_NOISE, WITHIN_TIMING, WITHIN_BASELINE = "tolerance", "noise", "timing", "baseline_error"
ALTERNATIVES, SIMULATION_ERROR = "alternatives", "simulation_error"
NOT_CONFIRMED, UNDETERMINED, LEAVES_MORE, UNCERTAIN = "not_confirmed", "undetermined", "leaves_more", "uncertain"
POSSIBLE = 0.1  # probability at which an effect outside the composition makes the verdict ambiguous
MAX_NONE = 1.0 / 3.0  # probability of no gap where the gap is not within anything: it never leads
MAX_UNKNOWN = 0.2  # probability of an unknown cause with which known ones are named: 0.16 at most in right blind cases
CLEAR = 1.5  # times noise and tolerance: a smaller gap is not named without references
MAX_MAP_REST = 0.2  # of the gap's energy: a smooth map absorbs a part of anything, so it must explain most to be named
MIN_MATERIAL_SHARE = 0.5  # of the energy that anything explains: an explanation that closes less is none
MIN_NAMED_SHARE = 0.5  # of the held-out gap's energy: what leaves more than it closes is not named
CLEARLY_LESS = 0.95  # of the gap that the composition leaves: another effect that leaves less may be the cause
MIN_PROBABILITY = 1e-12  # of a cause
IMMATERIAL = 0.1  # of the held-out gap's energy: closing less is no cause, leaving less no unknown cause


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
class SearchFindings:
    """What the search found on the fitted recordings, as numbers.

    `rest_N` is the RMS [N] that the best explanation and the generic learner leave; an effect below `visible_from_N`
    would hide behind noise and the simulation's own error. `interchangeable` are groups, `absorbed` the effects that a
    recalibration would imitate. The best explanation `is_map` if it holds errors of the simulation only. It may leave
    the share `twin_error` of the gap's energy because of a twin that replaces the simulation.
    """

    figures: VerdictFigures
    odds: Probabilities
    weights: Calibration
    size: GapSize
    rest_N: float
    visible_from_N: float
    tolerance_N: float
    has_references: bool
    interchangeable: tuple[tuple[str, ...], ...]
    absorbed: tuple[str, ...]
    is_map: bool
    twin_error: float = 0.0


@dataclass(frozen=True)
class VerdictEvidence:
    """All that a verdict follows from, as plain numbers; any of them may be unknown (NaN).

    On held-out recordings the gap has a size with an interval; the composition has `closed` a share of it, each effect
    alone another, the generic learner the share `learnt`. The composition `is_undetermined` if one of its effects may
    have no size.
    """

    search: SearchFindings
    held_out: GapSize
    held_out_ci95_N: tuple[float, float]
    composition: tuple[str, ...]  # without the simulation's timing, which is never named
    closed: ClosedShare
    closed_alone: Mapping[str, ClosedShare]
    learnt: float
    is_undetermined: bool = False

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


def judge(evidence: VerdictEvidence) -> Judgement:
    """Return the verdict: the largest of the probabilities of no gap, of an unknown cause and of the known effects.

    No gap also requires that the gap lies within what cannot be told from none. Known effects are "named" only if
    nothing speaks against them; whatever does becomes possible by it, and the verdict "ambiguous".
    """
    raw = _normalise(evidence.search.odds, evidence.composition)
    odds = weighed = _weigh_held_out(evidence, raw)
    if evidence.may_be_own_error:  # so may be what no effect explains
        odds = Probabilities(min(odds.none + odds.unknown, 1.0), 0.0, odds.effects)
    low, high = evidence.held_out_ci95_N
    within = min(probability_below(size.gap_N, evidence.search.tolerance_N, high - low) for size in evidence.sizes)
    odds = odds.with_none(max(odds.none, within))
    reason = find_no_gap_reason(evidence, odds.none >= max(odds.unknown, odds.known))
    if reason:
        return Judgement(NO_GAP, odds, reason)
    if not evidence.composition:
        odds = weighed
    odds = odds.with_none(min(odds.none, MAX_NONE))
    if not evidence.composition or odds.unknown > odds.known:
        return Judgement(UNKNOWN, odds)
    ties = _confirm(evidence, evidence.search.interchangeable)
    alternatives = _find_alternatives(evidence, odds, ties)
    odds = _reject(odds, evidence.composition, (*alternatives, CALIBRATION))
    doubts = _find_doubts(evidence, odds, alternatives, min(raw.known_given_gap, odds.known_given_gap))
    for names in doubts.values():
        odds = _make_possible(odds, names, evidence.composition)
    return Judgement(AMBIGUOUS if doubts else NAMED, odds, "", next(iter(doubts), ""), alternatives, ties)


def _normalise(odds: Probabilities, composition: Sequence[str]) -> Probabilities:
    """Return finite probabilities that sum to 1, each cause's above 0; unknown ones count as 0."""

    def known(probability: float) -> float:
        return min(max(probability, 0.0), 1.0) if math.isfinite(probability) else 0.0

    none, unknown = known(odds.none), known(odds.unknown)
    effects = {name: known(odds.effects.get(name, 0.0)) for name in dict.fromkeys((*odds.effects, *composition))}
    effects |= {name: max(effects[name], MIN_PROBABILITY) for name in composition}
    total = none + unknown + sum(effects.values())
    if total <= 0.0:
        return Probabilities(0.0, 1.0, effects)
    return Probabilities(none / total, unknown / total, {name: p / total for name, p in effects.items()})


def _weigh_held_out(e: VerdictEvidence, odds: Probabilities) -> Probabilities:
    """Return the probabilities after the held-out recordings.

    Known effects keep the share of their probability with which the best explanation closes what it must: half of what
    anything explains, of a map most of the gap, of what may be the simulation's own error nearly all. Where it leaves
    hardly anything, an unknown cause is improbable.
    """
    own = e.may_be_own_error  # a map of it is no cause
    alone = [c for name, c in e.closed_alone.items() if not (own and name == CALIBRATION)]
    found = [c for c in (e.closed, *alone) if not (math.isnan(c.value) or (own and e.search.is_map))]
    best = max((c.value for c in found), default=-math.inf)
    if not e.composition:  # no effect gains more than its error: none is more probable than an unknown cause
        return odds.with_unknown(odds.unknown + 0.5 * odds.known)
    if e.search.is_map and found:
        share = min(e.closed.value, 1.0 - e.search.figures.unexplained)
        support = replace(e.closed, value=share).probability_above(1.0 - MAX_MAP_REST)
    else:
        required = MIN_MATERIAL_SHARE * min(max(best, 0.0 if math.isnan(e.learnt) else e.learnt), 1.0)
        required = 1.0 - IMMATERIAL if own else required
        support = max((c.probability_above(max(required, IMMATERIAL)) for c in found), default=0.0)
    rest = min(1.0, max(1.0 - best, 0.0) / IMMATERIAL)
    return odds.with_unknown(rest * (odds.unknown + (1.0 - support) * odds.known))


def find_no_gap_reason(e: VerdictEvidence, is_improbable: bool) -> str:
    """Return within what the gap lies on fitted and held-out recordings, "" if there is one.

    Beyond the tolerance there is none only if a gap `is_improbable`, too, and noise that nothing measured is no reason.
    """
    if all(s.gap_N <= e.search.tolerance_N for s in e.sizes):
        return WITHIN_TOLERANCE
    if not is_improbable:
        return ""
    if e.search.has_references:
        return WITHIN_BASELINE if all(s.gap_N <= e.search.visible_from_N for s in e.sizes) else ""
    if all(s.noise_known and s.timed_N <= s.noise_N for s in e.sizes):
        return WITHIN_NOISE if all(s.gap_N <= s.noise_N for s in e.sizes) else WITHIN_TIMING
    return WITHIN_BASELINE if e.may_be_own_error else ""


def _confirm(e: VerdictEvidence, groups: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    most = 1.0 - max(e.search.twin_error, 0.0)  # the twin's error hides what closes more

    def seen(closed: ClosedShare) -> ClosedShare:
        return ClosedShare(*(min(share, most) for share in (closed.value, closed.low, closed.high)))

    others = {frozenset((name,)): seen(closed) for name, closed in e.closed_alone.items()}
    return confirm_ties(groups, e.composition, seen(e.closed), others)


def _find_alternatives(e: VerdictEvidence, odds: Probabilities, ties: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the effects that may be the cause instead: in `ties`, clearly better on held-out data, or probable.

    A recalibration can absorb a part of any effect; an effect that explains as much with less stands against it. What
    may be the simulation's own error decides between no effects.
    """
    gap_N, own_N = e.held_out.gap_N, e.held_out.own_error_N
    limit = CLEARLY_LESS**2 * (1.0 - e.closed.value) + (
        IMMATERIAL * (own_N / gap_N) ** 2 if gap_N > own_N > 0.0 else 0.0
    )
    better = [name for name, closed in e.closed_alone.items() if 1.0 - closed.value < limit]
    possible = [(e.composition[0], name) for name, p in odds.effects.items() if p >= POSSIBLE]
    alike = [name for group in (*ties, *_confirm(e, possible)) for name in group]
    found = dict.fromkeys((*alike, *better))
    return tuple(name for name in found if name not in (*e.composition, CALIBRATION))


def _find_doubts(
    e: VerdictEvidence, odds: Probabilities, alternatives: tuple[str, ...], known: float
) -> dict[str, tuple[str, ...]]:
    """Return what speaks against the composition, with the effects that are possible by it (none: an unknown cause).

    `known` is the probability of a known effect, given a gap. Without references a small gap, or an effect that a map
    imitates, may be the simulation's own error.
    """
    others = {name: p for name, p in odds.effects.items() if name not in e.composition}
    cause, error = odds.known - sum(others.values()), others.get(CALIBRATION, 0.0)
    is_absorbed = len(e.composition) > 1 and not set(e.composition).isdisjoint(e.search.absorbed)
    is_small = any(not s.gap_N > max(CLEAR * max(s.noise_N, e.search.tolerance_N), s.own_error_N) for s in e.sizes)
    may_be_error = (
        (is_absorbed and CALIBRATION not in e.composition)
        or (is_small and not e.search.has_references)
        or error > cause
    )
    least_gap, least_known = e.search.weights.least_gap, e.search.weights.least_known
    is_known = known >= least_known and cause >= max(odds.none, odds.unknown) and odds.unknown <= MAX_UNKNOWN
    is_certain = is_known and 1.0 - odds.none >= least_gap
    doubts = {
        ALTERNATIVES: alternatives or None,
        SIMULATION_ERROR: tuple({CALIBRATION} & {*others}) if may_be_error else None,
        NOT_CONFIRMED: None if e.closed.low > 0.0 else (),
        UNDETERMINED: () if e.is_undetermined else None,
        LEAVES_MORE: None if e.closed.value >= MIN_NAMED_SHARE else (),
        UNCERTAIN: None if is_certain else (),
    }
    return {doubt: names for doubt, names in doubts.items() if names is not None}


def _reject(odds: Probabilities, causes: Sequence[str], possible: Sequence[str]) -> Probabilities:
    """Return the probabilities after effects that held-out recordings leave not `possible` gave way to the `causes`."""
    kept = {n: p if n in (*causes, *possible) else min(p, POSSIBLE / 2.0) for n, p in odds.effects.items()}
    total, rest = sum(kept[name] for name in causes), odds.known - sum(kept.values())
    if total <= 0.0:
        return odds
    gained = {n: p + p / total * rest if n in causes else p for n, p in kept.items()}
    return Probabilities(odds.none, odds.unknown, gained)


def _make_possible(odds: Probabilities, names: Sequence[str], causes: Sequence[str]) -> Probabilities:
    """Return the probabilities after those of the `causes` gave way: each name, or an unknown cause, gets `POSSIBLE`.

    Together the known effects stay as probable as an unknown cause and no gap.
    """
    total, known = sum(odds.effects[name] for name in causes), odds.known
    level = min(POSSIBLE, total / (len(names) + 1))
    added = {name: max(level - odds.effects.get(name, 0.0), 0.0) for name in names}
    unknown = 0.0 if names else max(min(level - odds.unknown, (known - odds.unknown) / 2.0, known - odds.none), 0.0)
    kept = 1.0 - (sum(added.values()) + unknown) / total if total > 0.0 else 1.0
    effects = {name: p * kept if name in causes else p for name, p in odds.effects.items()}
    effects |= {name: effects.get(name, 0.0) + more for name, more in added.items()}
    return Probabilities(odds.none, odds.unknown + unknown, effects)
