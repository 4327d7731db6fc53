"""The review stage: a verdict must hold on the held-out recordings, or it is withdrawn. They never select a cause."""

from __future__ import annotations

from collections.abc import Sequence

from ces_gap.effects.effect import Effect
from ces_gap.inference.explanation import Estimate, Explanation
from ces_gap.inference.held_out import HeldOutScores
from ces_gap.inference.verdict import AMBIGUOUS, CALIBRATION, NAMED, NO_GAP, UNKNOWN

MIN_MATERIAL_SHARE = 0.5  # of the energy that anything explains: a cause that explains less is none
MIN_NAMED_SHARE = 0.5  # of the held-out gap's energy: what leaves more than it closes is not the cause of the gap
CLEARLY_LESS = 0.95  # of the gap that the composition leaves: another effect that leaves less is a rival


def review(verdict: str, scores: HeldOutScores) -> tuple[str, HeldOutScores]:
    """Return the verdict that held-out recordings support, and the scores without a composition that enlarges the gap.

    A cause is named only if its shrink is positive beyond its interval, material compared with what anything explains
    and with the gap, not exceeded by another effect, and if the intervals of its parameters exclude no effect.
    """
    composition = scores.composition
    if verdict == NO_GAP or not composition.effects:
        return verdict, scores
    if composition.gap_after_N >= scores.gap.corrected_N:
        return UNKNOWN, scores.without_composition()
    if not _is_material(scores):
        return UNKNOWN, scores
    if verdict == NAMED and _closed_share(scores, composition) < MIN_NAMED_SHARE:
        return UNKNOWN, scores
    doubts = composition.shrink_ci95[0] <= 0.0, bool(find_rivals(scores)), has_undetermined_effect(composition)
    if verdict == NAMED and any(doubts):
        return AMBIGUOUS, scores
    return verdict, scores


def find_rivals(scores: HeldOutScores) -> list[Explanation]:
    """Return the effects outside the composition that alone leave less of the held-out gap, the least first."""
    limit = CLEARLY_LESS * scores.composition.gap_after_N
    inside = (*scores.composition.effects, CALIBRATION)
    rivals = [c for c in scores.causes if c.effects[0] not in inside and c.gap_after_N < limit]
    return sorted(rivals, key=lambda c: c.gap_after_N)


def has_undetermined_effect(composition: Explanation) -> bool:
    """True if the 95 % interval of an effect's magnitude includes that it is not there.

    Several magnitudes of one effect may be uncertain each and certain together, so they are not judged one by one.
    """
    pairs = zip(composition.composition.settings, composition.estimates, strict=True)
    return any(_is_undetermined(setting.effect, estimates) for setting, estimates in pairs)


def _is_undetermined(effect: Effect, estimates: Sequence[Estimate]) -> bool:
    sizes = [(p, e) for p, e in zip(effect.parameters, estimates, strict=True) if p.magnitude]
    return len(sizes) == 1 and all(e.ci95[0] <= min(p.neutral, p.high) <= e.ci95[1] for p, e in sizes)


def _is_material(scores: HeldOutScores) -> bool:
    closed = _closed_share(scores, scores.composition)
    others = (_closed_share(scores, cause) for cause in scores.causes)
    learnt = 1.0 - (scores.ceiling_after_N / scores.gap.corrected_N) ** 2
    return closed >= MIN_MATERIAL_SHARE * max(closed, learnt, *others)


def _closed_share(scores: HeldOutScores, explanation: Explanation) -> float:
    """Return the share of the held-out gap's energy that an explanation closes."""
    return 1.0 - (explanation.gap_after_N / scores.gap.corrected_N) ** 2
