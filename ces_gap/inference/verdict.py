"""All rules of the verdict on one page: numbers in; verdict, probabilities, doubts and ties out.

1. No gap: what is within the tolerance, the noise, the timing of a log or the simulation's own error, and not rare.
2. Unknown: nothing was found, or what was found closes less than half of what anything closes on held-out recordings.
3. Named: one explanation leads, and no doubt is left. 4. Ambiguous: each doubt makes something else possible.

Each finding changes the probabilities, and the verdict follows from them, so that the two cannot contradict each other.
The odds of the search are those of `odds.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ces_gap.inference.judgement import (
    AMBIGUOUS,
    CALIBRATION,
    NAMED,
    NO_GAP,
    PARAMETERS,
    TIMING,
    UNKNOWN,
    ClosedShare,
    Doubt,
    GapSize,
    Judgement,
    Probabilities,
    VerdictEvidence,
    Within,
    probability_below,
)
from ces_gap.limits import SearchLimits, VerdictLimits


def judge(evidence: VerdictEvidence) -> Judgement:
    """Return the verdict: the largest of the probabilities of no gap, of an unknown cause and of the known effects.

    No gap also requires that the gap lies within what cannot be told from none, and that no rare deviation stands out.
    Known effects are "named" only if nothing speaks against them; whatever does becomes possible by it.
    """
    e, raw = evidence, evidence.search.odds.normalise(evidence.composition)
    odds = weighed = _weigh_held_out(e, raw)
    if not e.is_rare:
        odds = _weigh_within(e, odds)
        reason = _find_no_gap_reason(e, odds.none >= max(odds.unknown, odds.known))
        if reason:
            return Judgement(NO_GAP, odds, reason)
    if not e.composition:
        odds = weighed
    odds = odds.with_none(min(odds.none, VerdictLimits.MAX_NONE))
    if not e.composition or odds.unknown > odds.known:
        return Judgement(UNKNOWN, odds)
    ties = confirm_ties(e, e.search.interchangeable)
    alternatives = _find_alternatives(e, odds, ties)
    odds = _reject(odds, e.composition, (*alternatives, CALIBRATION))
    doubts = _find_doubts(e, odds, alternatives, min(raw.known_given_gap, odds.known_given_gap))
    for names in doubts.values():
        odds = make_possible(odds, names, e.composition)
    return Judgement(AMBIGUOUS if doubts else NAMED, odds, "", next(iter(doubts), ""), alternatives, ties)


def _weigh_held_out(e: VerdictEvidence, odds: Probabilities) -> Probabilities:
    """Return the probabilities after the held-out recordings.

    Known effects keep the share of their probability with which the best explanation closes what it must: half of what
    anything explains, of a map most of the gap, of what may be the simulation's own error nearly all. Where it leaves
    hardly anything, an unknown cause is improbable.
    """
    own = e.may_be_own_error  # a map of it is no cause
    alone = [c for name, c in e.closed_alone.items() if not (own and name == CALIBRATION)]
    closed = [c for c in (e.closed, *alone) if not (math.isnan(c.value) or (own and e.search.is_map))]
    best = max((c.value for c in closed), default=-math.inf)
    if not e.composition:  # no effect gains more than its error: none is more probable than an unknown cause
        return odds.with_unknown(odds.unknown + VerdictLimits.HALF * odds.known)
    if e.search.is_map and closed:
        share = min(e.closed.value, 1.0 - e.search.figures.unexplained)
        support = ClosedShare(share, e.closed.low, e.closed.high).probability_above(1.0 - VerdictLimits.MAX_MAP_REST)
    else:
        required = VerdictLimits.HALF * min(max(best, 0.0 if math.isnan(e.learnt) else e.learnt), 1.0)
        required = 1.0 - VerdictLimits.TENTH if own else required
        support = max((c.probability_above(max(required, VerdictLimits.TENTH)) for c in closed), default=0.0)
    rest = min(1.0, max(1.0 - best, 0.0) / VerdictLimits.TENTH)
    return odds.with_unknown(rest * (odds.unknown + (1.0 - support) * odds.known))


def _weigh_within(e: VerdictEvidence, odds: Probabilities) -> Probabilities:
    """Return the probabilities after what the gap may lie within: own error, tolerance, noise, the timing of a log."""
    if e.may_be_own_error:  # so may be what no effect explains
        odds = Probabilities(min(odds.none + odds.unknown, 1.0), 0.0, odds.effects)
    low, high = e.held_out_ci95_N
    within = min(probability_below(size.gap_N, e.search.tolerance_N, high - low) for size in e.sizes)
    physics = [c.value for name, c in e.closed_alone.items() if name not in (CALIBRATION, TIMING)]
    physics += [] if e.search.is_map or {*e.composition} <= {TIMING} else [e.closed.value]
    if all(_is_within_noise(s, s.gap_N) for s in e.sizes) and not any(share >= VerdictLimits.HALF for share in physics):
        within = max(within, VerdictLimits.HALF)  # nothing in it has a shape
    log = e.search.is_recorded and {*e.composition} <= {TIMING}
    if log and all(_is_within_noise(s, s.timed_N) for s in e.sizes):  # a sample of a log, not of the simulation
        within = max(within, odds.none + odds.effects.get(TIMING, 0.0))
    return odds.with_none(max(odds.none, min(within, 1.0)))


def _is_within_noise(size: GapSize, gap_N: float) -> bool:
    return size.noise_known and gap_N <= size.noise_N


def _find_no_gap_reason(e: VerdictEvidence, is_improbable: bool) -> str:
    """Return within what the gap lies on fitted and held-out recordings, "" if there is one.

    Beyond the tolerance there is none only if a gap `is_improbable`, too, and noise that nothing measured is no reason.
    """
    if all(s.gap_N <= e.search.tolerance_N for s in e.sizes):
        return Within.TOLERANCE
    if not is_improbable:
        return ""
    if e.search.has_references:
        return Within.BASELINE_ERROR if all(s.gap_N <= e.search.visible_from_N for s in e.sizes) else ""
    if all(_is_within_noise(s, s.timed_N) for s in e.sizes):
        return Within.NOISE if all(s.gap_N <= s.noise_N for s in e.sizes) else Within.TIMING
    return Within.BASELINE_ERROR if e.may_be_own_error else ""


def confirm_ties(e: VerdictEvidence, groups: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], ...]:
    """Return the `groups` (`search.interchangeable_effects`) that held-out recordings confirm.

    Each begins with an effect of the composition. One that can replace it stays, unless it was scored in its place
    and leaves clearly more. A twin's error hides what closes more than it allows.
    """
    most = 1.0 - max(e.search.twin_error, 0.0)

    def limit_share(closed: ClosedShare) -> ClosedShare:
        return ClosedShare(*(min(share, most) for share in (closed.value, closed.low, closed.high)))

    def is_rejected(member: str, name: str) -> bool:
        is_scored = {*e.composition} == {member} and name in e.closed_alone
        return is_scored and leaves_clearly_more(limit_share(e.closed_alone[name]), limit_share(e.closed))

    close = [(member, *(n for n in names if not is_rejected(member, n))) for member, *names in groups]
    return tuple(group for group in close if len(group) > 1)


def leaves_clearly_more(other: ClosedShare, best: ClosedShare) -> bool:
    """True if `other` leaves clearly more of the gap than `best`, or closes less by more than its interval."""
    return 1.0 - other.value > VerdictLimits.CLEARLY_MORE**2 * (1.0 - best.value) or other.high < best.value


def _find_alternatives(e: VerdictEvidence, odds: Probabilities, ties: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the effects that may be the cause instead: in `ties`, better on held-out data, probable, or imitated.

    A map stands for each effect that it imitates and that closes half as much alone. What may be the simulation's own
    error decides between no effects.
    """
    gap_N, own_N = e.held_out.gap_N, e.held_out.own_error_N
    limit = 1.0 - e.closed.value + (VerdictLimits.TENTH * (own_N / gap_N) ** 2 if gap_N > own_N > 0.0 else 0.0)
    better = [name for name, closed in e.closed_alone.items() if 1.0 - closed.value < limit]
    mapped = {name for name in e.search.absorbed if e.search.is_map and CALIBRATION in e.composition}
    half = VerdictLimits.HALF * e.closed.value
    imitated = [name for name in mapped & {*e.closed_alone} if e.closed_alone[name].value >= half]
    possible = [(e.composition[0], name) for name, p in odds.effects.items() if p >= VerdictLimits.TENTH]
    alike = [name for group in (*ties, *confirm_ties(e, possible)) for name in group]
    names_found = dict.fromkeys((*alike, *better, *sorted(imitated)))
    return tuple(name for name in names_found if name not in (*e.composition, CALIBRATION))


def _find_doubts(
    e: VerdictEvidence, odds: Probabilities, alternatives: tuple[str, ...], known: float
) -> dict[str, tuple[str, ...]]:
    """Return what speaks against the composition, with the effects that are possible by it (none: an unknown cause).

    `known` is the probability of a known effect, given a gap. Something remains where a learner without physics leaves
    clearly less than the composition, or a rare deviation stands out: a cause not in the library, or a second one.
    """
    others = {name: p for name, p in odds.effects.items() if name not in e.composition}
    cause, error = odds.known - sum(others.values()), others.get(CALIBRATION, 0.0)
    weights, missed = e.search.weights, e.learnt - e.closed.value
    is_known = (
        known >= weights.least_known
        and cause >= max(odds.none, odds.unknown)
        and odds.unknown <= VerdictLimits.MAX_UNKNOWN
    )
    remains = missed > max(SearchLimits.NEGLIGIBLE, e.search.twin_error) and (
        math.sqrt(missed) * e.held_out.gap_N > e.in_band_N
    )
    doubts = {
        Doubt.ALTERNATIVES: alternatives or None,
        Doubt.SIMULATION_ERROR: tuple({CALIBRATION} & {*others}) if error > cause or _may_be_error(e) else None,
        Doubt.NOT_CONFIRMED: None if e.closed.low > 0.0 else (),
        Doubt.UNDETERMINED: () if e.is_undetermined else None,
        Doubt.LEAVES_MORE: None if e.closed.value >= VerdictLimits.HALF else (),
        Doubt.REMAINS: () if remains or e.leaves_rare else None,
        Doubt.UNCERTAIN: None if is_known and 1.0 - odds.none >= weights.least_gap else (),
    }
    return {doubt: names for doubt, names in doubts.items() if names is not None}


def _may_be_error(e: VerdictEvidence) -> bool:
    """True without references if a cause may be the simulation's own error: small, imitated, or a map leaves less."""
    if e.search.has_references or {*e.composition} <= {TIMING, PARAMETERS}:
        return False
    least = [max(VerdictLimits.CLEAR * max(s.noise_N, e.search.tolerance_N), s.own_error_N) for s in e.sizes]
    if any(not size.gap_N > least_N for size, least_N in zip(e.sizes, least, strict=True)):
        return True
    if CALIBRATION in e.composition:
        return False
    mapped = e.closed_alone.get(CALIBRATION)
    return (mapped is not None and mapped.value > e.closed.value) or (
        len(e.composition) > 1 and not {*e.composition}.isdisjoint(e.search.absorbed)
    )


def _reject(odds: Probabilities, causes: Sequence[str], possible: Sequence[str]) -> Probabilities:
    """Return the probabilities after effects that held-out recordings leave not `possible` gave way to the `causes`."""
    kept = {n: p if n in (*causes, *possible) else min(p, VerdictLimits.TENTH / 2.0) for n, p in odds.effects.items()}
    total, rest = sum(kept[name] for name in causes), odds.known - sum(kept.values())
    if total <= 0.0:
        return odds
    gained = {n: p + p / total * rest if n in causes else p for n, p in kept.items()}
    return Probabilities(odds.none, odds.unknown, gained)


def make_possible(odds: Probabilities, names: Sequence[str], causes: Sequence[str]) -> Probabilities:
    """Return the probabilities after those of the `causes` gave way: each name, or an unknown cause, gets a tenth.

    Together the known effects stay as probable as an unknown cause and no gap.
    """
    total, known = sum(odds.effects[name] for name in causes), odds.known
    level = min(VerdictLimits.TENTH, total / (len(names) + 1))
    added = {name: max(level - odds.effects.get(name, 0.0), 0.0) for name in names}
    unknown = 0.0 if names else max(min(level - odds.unknown, (known - odds.unknown) / 2.0, known - odds.none), 0.0)
    kept = 1.0 - (sum(added.values()) + unknown) / total if total > 0.0 else 1.0
    effects = {name: p * kept if name in causes else p for name, p in odds.effects.items()}
    effects |= {name: effects.get(name, 0.0) + more for name, more in added.items()}
    return Probabilities(odds.none, odds.unknown + unknown, effects)
