"""The review stage: a verdict must hold on the held-out recordings, or it is withdrawn. They never select a cause."""

from __future__ import annotations

from ces_gap.inference.explanation import Explanation
from ces_gap.inference.held_out import HeldOutScores
from ces_gap.inference.verdict import AMBIGUOUS, CALIBRATION, NAMED, NO_GAP, UNKNOWN

MIN_MATERIAL_SHARE = 0.5  # of the energy that anything explains: a cause that explains less is none
CLEARLY_LESS = 0.95  # of the gap that the composition leaves: another effect that leaves less is a rival


def review(verdict: str, scores: HeldOutScores) -> tuple[str, HeldOutScores]:
    """Return the verdict that held-out recordings support, and the scores without a composition that enlarges the gap.

    A cause is named only if its shrink is positive beyond its interval, material compared with what anything explains,
    and not exceeded by another effect.
    """
    composition = scores.composition
    if verdict == NO_GAP or not composition.effects:
        return verdict, scores
    if composition.gap_after_N >= scores.gap.corrected_N:
        return UNKNOWN, scores.without_composition()
    if not _is_material(scores):
        return UNKNOWN, scores
    if verdict == NAMED and (composition.shrink_ci95[0] <= 0.0 or find_rivals(scores)):
        return AMBIGUOUS, scores
    return verdict, scores


def find_rivals(scores: HeldOutScores) -> list[Explanation]:
    """Return the effects outside the composition that alone leave less of the held-out gap, the least first."""
    limit = CLEARLY_LESS * scores.composition.gap_after_N
    inside = (*scores.composition.effects, CALIBRATION)
    rivals = [c for c in scores.causes if c.effects[0] not in inside and c.gap_after_N < limit]
    return sorted(rivals, key=lambda c: c.gap_after_N)


def _is_material(scores: HeldOutScores) -> bool:
    afters = [scores.composition.gap_after_N, scores.ceiling_after_N, *(c.gap_after_N for c in scores.causes)]
    closed = [1.0 - (after / scores.gap.corrected_N) ** 2 for after in afters]
    return closed[0] >= MIN_MATERIAL_SHARE * max(closed)
