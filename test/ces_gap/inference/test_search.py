"""The search: planted effects are found, noise gives none, a richer or wrong effect must explain more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engine_plant import traced
from search_examples import EFFECTS, FRICTION, OFFSET, PLANT, SPRING, CubicSpring, planted, run_search

from ces_gap.baseline.learner import make_white_noise
from ces_gap.effects.effect import Setting
from ces_gap.effects.library import library_effect
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.fit import EffectFit, Refinement, fit_alone, fit_together
from ces_gap.inference.search import (
    CompositionSearch,
    EffectSearchResult,
    compute_paired_gain,
    interchangeable_effects,
    loses_to_nested_form,
    min_unexplained_shares,
    order_nested_forms,
    rank_additions,
    search,
)


def best_values(result: EffectSearchResult) -> dict[str, tuple[float, ...]]:
    return {s.name: s.values for s in result.best.composition.settings} if result.best is not None else {}


@pytest.mark.parametrize("single", [OFFSET, SPRING, FRICTION], ids=lambda s: s.name)
def test_a_single_effect_stays_single(single: Setting) -> None:
    result = run_search(planted(single))
    assert list(best_values(result)) == [single.name]
    assert best_values(result)[single.name] == pytest.approx(single.values, rel=0.15)
    assert result.alone[0].names == (single.name,)
    assert sorted(f.names[0] for f in result.alone) == ["current_offset", "friction", "offset", "spring"]


@pytest.mark.parametrize("pair", [(SPRING, FRICTION), (OFFSET, SPRING, FRICTION)], ids=len)
def test_several_planted_effects_are_found(pair: tuple[Setting, ...]) -> None:
    values = best_values(run_search(planted(*pair)))
    assert set(values) == {s.name for s in pair}
    for setting in pair:
        assert values[setting.name] == pytest.approx(setting.values, rel=0.15)


@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_is_found_in_noise(seed: int) -> None:
    assert run_search(planted(seed=seed)).best is None


def test_the_simpler_form_is_kept_while_the_richer_one_gains_nothing() -> None:
    result = run_search(planted(SPRING))
    assert result.best is not None and result.best.effects[0].form == "linear"
    cubic = run_search(planted(Setting(CubicSpring(), (1000.0, 8e6))))
    assert cubic.best is not None and cubic.best.effects[0].form == "cubic"


def test_threads_change_nothing() -> None:
    evidence = planted(SPRING, FRICTION)
    assert best_values(run_search(evidence, threads=3)) == best_values(run_search(evidence))


def test_the_most_promising_fits_are_refined_and_the_result_counts() -> None:
    evidence = planted(SPRING)
    refined_names: list[tuple[str, ...]] = []

    class WithoutSprings(Refinement):
        """The simulation itself has no spring."""

        def refine(self, evidence: Evidence, fit: EffectFit) -> EffectFit:
            refined_names.append(fit.names)
            worse = replace(fit, residual=fit.residual * 30.0, left_out=fit.left_out * 30.0)
            return worse if "spring" in fit.names else fit

    result = search(evidence, EFFECTS, WithoutSprings(), 1)
    assert ("spring",) in refined_names
    assert result.alone[0].names != ("spring",)
    assert result.best is None or "spring" not in result.best.names


def test_a_gain_is_that_of_squares_and_its_error_that_of_blocks() -> None:
    traces = [traced(seed=s, seconds=10.0) for s in (1, 2)]
    evidence = gather(traces, PLANT, make_white_noise(8.0), [np.zeros((len(t), 1)) for t in traces], np.zeros((1, 1)))
    rng = np.random.default_rng(1)
    draws = [
        (rng.standard_normal(len(evidence.block_of_row)), rng.standard_normal(len(evidence.block_of_row)))
        for _ in range(100)
    ]
    gains = [compute_paired_gain(evidence, worse, better) for worse, better in draws]
    assert gains[0].energy == pytest.approx(draws[0][0] @ draws[0][0] - draws[0][1] @ draws[0][1])
    assert np.mean([g.error for g in gains]) == pytest.approx(np.std([g.energy for g in gains]), rel=0.2)
    assert gains[0].z == pytest.approx(gains[0].energy / gains[0].error)
    same = compute_paired_gain(evidence, draws[0][0], draws[0][0])
    assert same.energy == 0.0 and same.z == 0.0


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
    assert all(f.cost > best.cost and len(f.names) == 2 for f in tried)


def test_an_unnecessary_effect_is_removed() -> None:
    compositions = build_search(planted(SPRING))
    best, _ = compositions.improve(fit_composition(compositions, "spring", "current_offset"))
    assert best.names == ("spring",)


def test_additions_are_ranked_by_expected_gain_once_per_effect() -> None:
    compositions = build_search(planted(OFFSET, FRICTION, Setting(EFFECTS[1], (300.0,))))
    order = [
        f.names[0]
        for f in rank_additions(
            fit_composition(compositions, "friction"), compositions.forms, compositions.baseline_residual
        )
    ]
    assert order[0] == "offset" and sorted(order) == ["current_offset", "offset", "spring"]


GAS, CONSTANT = library_effect("gas_spring", "charged"), library_effect("force_offset", "constant")

OTHERS = tuple(e for e in EFFECTS if e.name == "friction")


def search_around(effect: Setting, seed: int = 5) -> EffectSearchResult:
    return search(planted(effect, seed=seed), (CONSTANT, GAS, *OTHERS), Refinement(), 1)


@pytest.mark.parametrize(
    ("planted_effect", "loser"),
    [(Setting(GAS, (60.0, 0.4)), "force_offset"), (Setting(CONSTANT, (60.0,)), "gas_spring")],
    ids=["gas", "offset"],
)
def test_a_visible_difference_decides_however_small_its_share(planted_effect: Setting, loser: str) -> None:
    result = search_around(planted_effect)
    assert result.best is not None and result.best.names == (planted_effect.name,)
    assert interchangeable_effects(result) == ()
    shares = min_unexplained_shares(result)
    assert shares[loser] > shares[planted_effect.name] + 0.04
    costs = {f.names[0]: f.cost for f in result.alone}
    assert abs(costs["gas_spring"] - costs["force_offset"]) < 0.05 * result.gap_energy  # a share alone does not decide


def test_an_invisible_difference_leaves_both() -> None:
    result = search_around(Setting(GAS, (6.0, 0.4)), seed=6)
    assert [set(group) for group in interchangeable_effects(result)] == [{"gas_spring", "force_offset"}]


def test_fits_that_differ_in_more_or_in_unrelated_effects_do_not_decide() -> None:
    evidence = planted(Setting(GAS, (60.0, 0.4)))
    gas, offset, friction = (fit_alone(evidence, e) for e in (GAS, CONSTANT, *OTHERS))
    assert loses_to_nested_form(evidence, offset, gas) and not loses_to_nested_form(evidence, gas, offset)
    assert not loses_to_nested_form(evidence, friction, gas) and not loses_to_nested_form(evidence, gas, gas)
    assert order_nested_forms(evidence, (offset, friction, gas)) == (gas, offset, friction)
