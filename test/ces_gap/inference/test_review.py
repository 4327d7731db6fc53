"""The review: what the held-out recordings do not support is not named."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnoses import named

from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Explanation
from ces_gap.inference.held_out import HeldOutScores, find_better_effects, review

FOUND = named()
NOTHING = replace(FOUND.composition, effects=(), forms=(), gap_after_N=36.1, shrink=0.0, shrink_ci95=(0.0, 0.0))
SCORES = HeldOutScores(FOUND.gap, 4.0, FOUND.causes, FOUND.composition, FOUND.held_out, NOTHING)


def with_composition(**changed: object) -> HeldOutScores:
    return replace(SCORES, composition=replace(SCORES.composition, **changed))  # type: ignore[arg-type]


def with_cause(name: str, after_N: float) -> HeldOutScores:
    first, second, *others = SCORES.causes
    rival: Explanation = replace(second, effects=(name,), gap_after_N=after_N)
    return replace(SCORES, causes=(first, rival, *others))


def test_a_cause_that_held_out_recordings_confirm_stays_named() -> None:
    assert review(NAMED, SCORES) == (NAMED, SCORES)


def test_a_composition_that_enlarges_the_gap_is_withdrawn() -> None:
    verdict, scores = review(NAMED, with_composition(gap_after_N=50.0, shrink=-0.25, shrink_ci95=(-0.4, -0.1)))
    assert verdict == UNKNOWN and scores.composition == NOTHING
    assert all((s.augmented == s.corrected).all() for s in scores.series)


def test_a_shrink_that_may_be_none_is_not_named() -> None:
    assert review(NAMED, with_composition(shrink_ci95=(-0.05, 0.4)))[0] == AMBIGUOUS


def test_a_cause_that_closes_little_of_what_can_be_explained_is_unknown() -> None:
    assert review(NAMED, with_composition(gap_after_N=34.0))[0] == UNKNOWN
    assert review(AMBIGUOUS, with_composition(gap_after_N=34.0))[0] == UNKNOWN


@pytest.mark.parametrize(("rival", "verdict"), [("valve_lag", AMBIGUOUS), ("calibration", NAMED)])
def test_an_effect_that_leaves_less_is_a_rival_but_a_flexible_map_is_not(rival: str, verdict: str) -> None:
    scores = with_cause(rival, 0.8 * SCORES.composition.gap_after_N)
    assert review(NAMED, scores)[0] == verdict
    assert bool(find_better_effects(scores)) == (verdict == AMBIGUOUS)


def test_what_leaves_more_than_it_closes_is_not_the_cause() -> None:
    scores = replace(with_composition(gap_after_N=27.0), ceiling_after_N=27.0)
    scores = replace(scores, causes=tuple(replace(c, gap_after_N=27.0) for c in SCORES.causes))
    assert review(NAMED, scores)[0] == UNKNOWN


def test_an_effect_whose_interval_includes_none_is_not_named() -> None:
    first, *others = SCORES.composition.estimates[0]
    loose = ((replace(first, ci95=(-5.0, 80.0)), *others),)
    assert review(NAMED, with_composition(estimates=loose))[0] == AMBIGUOUS


def test_no_gap_is_not_reviewed() -> None:
    assert review(NO_GAP, with_composition(gap_after_N=50.0))[0] == NO_GAP
