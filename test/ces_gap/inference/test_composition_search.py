"""Search for compositions: a wrong effect is replaced, an unnecessary one removed, the right one stays."""

from __future__ import annotations

from dataclasses import replace

from search_examples import EFFECTS, FRICTION, OFFSET, SPRING, planted

from ces_gap.effects.effect import Setting
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit, Refinement, fit_alone, fit_together
from ces_gap.inference.search import CompositionSearch, rank_additions, split_composition


def build_search(evidence: Evidence) -> CompositionSearch:
    residual = evidence.residual(evidence.alone)
    forms = [fit_alone(evidence, effect) for effect in EFFECTS]
    return CompositionSearch(evidence, residual, forms, float(residual @ residual) - len(residual), Refinement())


def fit_composition(compositions: CompositionSearch, *names: str) -> EffectFit:
    chosen = [next(f for f in compositions.forms if f.names == (name,)) for name in names]
    return fit_together(compositions.evidence, chosen)


def test_the_true_effect_replaces_a_wrong_one() -> None:
    compositions = build_search(planted(OFFSET, FRICTION))
    best, tried = compositions.improve(fit_composition(compositions, "current_offset", "friction"))
    assert set(best.names) == {"offset", "friction"}
    assert any(set(f.names) == {"current_offset", "friction"} for f in tried) and best not in tried


def test_an_unnecessary_effect_is_removed() -> None:
    compositions = build_search(planted(SPRING))
    best, _ = compositions.improve(fit_composition(compositions, "spring", "current_offset"))
    assert best.names == ("spring",)


def test_worse_replacements_are_returned_with_the_best() -> None:
    compositions = build_search(planted(OFFSET, FRICTION))
    best, tried = compositions.improve(fit_composition(compositions, "offset", "friction"))
    assert set(best.names) == {"offset", "friction"}
    assert tried and all(f.cost > best.cost and len(f.names) == 2 for f in tried)


def test_replacements_are_fitted_on_anchored_evidence_and_refined_on_the_original() -> None:
    evidence = planted(OFFSET, FRICTION)
    close, refined = replace(evidence), []

    class RecordingRefinement(Refinement):
        def refine(self, evidence: Evidence, fit: EffectFit) -> EffectFit:
            refined.append(evidence)
            return fit

        def anchor(self, evidence: Evidence, fit: EffectFit) -> Evidence:
            return close

    compositions = replace(build_search(evidence), refinement=RecordingRefinement())
    compositions.improve(fit_composition(compositions, "offset", "friction"))
    assert refined and all(used is evidence for used in refined)


def test_additions_are_ranked_by_expected_gain_once_per_effect() -> None:
    compositions = build_search(planted(OFFSET, FRICTION, Setting(EFFECTS[1], (300.0,))))
    order = [
        f.names[0]
        for f in rank_additions(
            fit_composition(compositions, "friction"), compositions.forms, compositions.baseline_residual
        )
    ]
    assert order[0] == "offset" and sorted(order) == ["current_offset", "offset", "spring"]


def test_parts_have_the_parameters_of_the_composition() -> None:
    compositions = build_search(planted(SPRING, FRICTION))
    both = fit_composition(compositions, "spring", "friction")
    values = [s.values for part in split_composition(both, compositions.forms) for s in part.composition.settings]
    assert values == [s.values for s in both.composition.settings]
