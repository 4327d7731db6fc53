"""A composition contested: a wrong member is swapped out, a needless one dropped, the right one stays."""

from __future__ import annotations

from dataclasses import replace

from test_search import EFFECTS, FRICTION, OFFSET, SPRING, planted

from ces_gap.effects.effect import Setting
from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.compositions import rank_additions, split_composition
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, fit_alone, fit_together
from ces_gap.inference.swap_search import SwapSearch


def contest(evidence: Evidence) -> SwapSearch:
    none = evidence.residual(evidence.alone)
    forms = [fit_alone(evidence, effect) for effect in EFFECTS]
    return SwapSearch(evidence, none, forms, float(none @ none) - len(none), Refinement())


def together(arena: SwapSearch, *names: str) -> EffectFit:
    chosen = [next(f for f in arena.forms if f.names == (name,)) for name in names]
    return fit_together(arena.evidence, chosen)


def test_the_true_effect_takes_the_place_of_another() -> None:
    arena = contest(planted(OFFSET, FRICTION))
    best, tried = arena.improve(together(arena, "current_offset", "friction"))
    assert set(best.names) == {"offset", "friction"}
    assert any(set(f.names) == {"current_offset", "friction"} for f in tried) and best not in tried


def test_a_needless_member_is_dropped() -> None:
    arena = contest(planted(SPRING))
    best, _ = arena.improve(together(arena, "spring", "current_offset"))
    assert best.names == ("spring",)


def test_what_leaves_more_is_kept_beside_the_winner() -> None:
    arena = contest(planted(OFFSET, FRICTION))
    best, tried = arena.improve(together(arena, "offset", "friction"))
    assert set(best.names) == {"offset", "friction"}
    assert tried and all(f.cost > best.cost and len(f.names) == 2 for f in tried)


def test_swaps_are_tried_on_the_evidence_near_the_best_and_refined_on_the_whole() -> None:
    evidence = planted(OFFSET, FRICTION)
    close, refined = evidence.scale_noise(1.0), []

    class Watched(Refinement):
        def refine(self, evidence: Evidence, fit: EffectFit) -> EffectFit:
            refined.append(evidence)
            return fit

        def anchor(self, evidence: Evidence, fit: EffectFit) -> Evidence:
            return close

    arena = replace(contest(evidence), refinement=Watched())
    arena.improve(together(arena, "offset", "friction"))
    assert refined and all(given is evidence for given in refined)


def test_each_effect_is_ranked_once_and_what_promises_most_is_first() -> None:
    arena = contest(planted(OFFSET, FRICTION, Setting(EFFECTS[1], (300.0,))))
    order = [f.names[0] for f in rank_additions(together(arena, "friction"), arena.forms, arena.baseline_residual)]
    assert order[0] == "offset" and sorted(order) == ["current_offset", "offset", "spring"]


def test_parts_begin_where_the_composition_ended() -> None:
    arena = contest(planted(SPRING, FRICTION))
    both = together(arena, "spring", "friction")
    values = [s.values for part in split_composition(both, arena.forms) for s in part.composition.settings]
    assert values == [s.values for s in both.composition.settings]
