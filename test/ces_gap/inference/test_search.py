"""The search: planted effects are found, noise gives none, a richer or wrong effect must explain more; alternatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from engine_plant import F, traced
from example_effects import Friction, Spring
from search_examples import EFFECTS, FRICTION, OFFSET, PLANT, SPRING, CubicSpring, Offset, planted, run_search

from ces_gap.baseline.learner import make_white_noise
from ces_gap.effects.effect import Effect, EffectParameter, Setting
from ces_gap.effects.library import library_effect
from ces_gap.effects.simulation_errors import ForceMap
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.fit import EffectFit, fit_alone, fit_together
from ces_gap.inference.refinement import Refinement
from ces_gap.inference.search import (
    CompositionSearch,
    EffectSearchResult,
    compute_paired_gain,
    find_absorbed_effects,
    find_alternatives,
    interchangeable_effects,
    min_unexplained_shares,
    search,
)
from ces_gap.limits import SearchLimits, VerdictLimits
from ces_gap.trace import Trace, TraceInputs


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


class Tare(Offset):
    """The same constant with another name and an invisible trend."""

    name, form = "tare", "creeping"
    parameters = (EffectParameter("tare_N", -500.0, 500.0, (10.0,), "offset", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: np.ndarray, values: object) -> np.ndarray:
        return np.asarray(super().respond(trace, inputs, force, values) + 1e-3 * trace.time_s)  # type: ignore[arg-type]


def with_tare(evidence: Evidence) -> EffectSearchResult:
    return search(evidence, (*EFFECTS, Tare()), Refinement(), 1)


def test_an_effect_that_replaces_another_beside_a_third_is_an_alternative() -> None:
    result = with_tare(planted(OFFSET, FRICTION))
    assert result.best is not None and len(result.best.effects) == 2 and "friction" in result.best.names
    group = next(g for g in interchangeable_effects(result) if g[0] != "friction")
    assert set(group) == {"offset", "tare"} and group[0] in result.best.names
    shares = min_unexplained_shares(result)
    assert shares["offset"] == pytest.approx(shares["tare"], abs=0.01)
    alone = {f.names[0]: (f.cost - len(result.baseline_residual)) / result.gap_energy for f in result.alone}
    assert shares["tare"] < 0.05 < alone["tare"]  # alone it leaves the friction as well


def test_alternatives_to_a_single_effect_are_single_effects() -> None:
    result = with_tare(planted(OFFSET))
    assert {frozenset(g) for g in interchangeable_effects(result)} == {frozenset(("offset", "tare"))}
    assert all(len(f.names) == 1 for f in find_alternatives(result))


@pytest.mark.parametrize("constant_A", [0.09, None], ids=["constant", "changing"])
def test_gains_of_current_and_force_are_alternatives_at_constant_current_only(constant_A: float | None) -> None:
    forms = (library_effect("current_scale", "gain"), library_effect("force_scale", "gain"))
    traces = [traced(seed=s, seconds=4.0, constant_A=constant_A) for s in (1, 2)]
    result = search(planted(FRICTION, traces=traces), forms, Refinement(), 1)
    worse, better = sorted((f.cost for f in result.alone), reverse=True)
    share = (worse - better) / result.gap_energy
    assert SearchLimits.NEGLIGIBLE < share < VerdictLimits.TENTH  # the difference is visible in both
    groups = [set(group) for group in interchangeable_effects(result)]
    assert groups == ([{"current_scale", "force_scale"}] if constant_A else [])


@pytest.mark.parametrize("effects", [(SPRING,), (SPRING, FRICTION)], ids=["one", "two"])
def test_distinguishable_effects_are_not_interchangeable(effects: tuple) -> None:
    result = run_search(planted(*effects))
    assert interchangeable_effects(result) == () and find_alternatives(result)
    shares = min_unexplained_shares(result)
    assert min(shares[n] for n in shares if n not in {s.name for s in effects}) > SearchLimits.NEGLIGIBLE


class Chirps(Effect):
    """A force of elapsed time, which no map of stroke, speed and current holds."""

    name, form = "chirps", "time"
    parameters = (EffectParameter("size_N", 0.0, 300.0, (20.0,), "size", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: F, values: Sequence[float]) -> F:
        return np.asarray(force + values[0] * np.sin(20.0 * trace.time_s**1.2))


def searched(*settings: Setting, effects: tuple[Effect, ...]) -> EffectSearchResult:
    evidence = planted(*settings, seed=1, traces=[traced(seed=s) for s in (1, 2)])
    return search(evidence, effects, Refinement(), 1)


def test_effects_inside_the_map_are_reported() -> None:
    both = Setting(Spring(), (3000.0,)), Setting(Chirps(), (40.0,))
    assert find_absorbed_effects(searched(*both, effects=(Spring(), Chirps(), ForceMap()))) == ("spring",)
    assert find_absorbed_effects(searched(*both, effects=(Spring(), Chirps()))) == ()
    found = searched(Setting(Spring(), (3000.0,)), effects=(Spring(), Chirps(), ForceMap()))
    assert found.best is not None and found.best.names == ("spring",)  # explains as much as the map


def test_a_map_that_explains_more_than_any_effect_is_the_cause() -> None:
    off = Setting(ForceMap(), (20.0, 300.0, 0.0, -400.0, 30.0, 1500.0, 0.0, 0.0))
    found = searched(off, effects=(Spring(), Chirps(), ForceMap()))
    assert found.best is not None and found.best.names == ("calibration",)
    assert found.best.composition.settings[0].values[0] == np.clip(found.best.searched[0], 17.0, 23.0)


def test_two_effects_take_the_place_of_a_map_that_leaves_more() -> None:
    pair = Setting(Spring(), (3000.0,)), Setting(Friction(), (40.0, 0.01))  # the map lacks the reversals only
    evidence = planted(*pair, seed=1, traces=[traced(seed=s) for s in (1, 2)])
    found = search(evidence, (Spring(), Friction(), ForceMap()), Refinement(), 1, min_gain_share=0.12)
    (mapped,) = (fit for fit in found.alone if fit.names == ("calibration",))
    assert mapped.cost - len(mapped.residual) < 0.12 * found.gap_energy
    assert found.best is not None and set(found.best.names) == {"spring", "friction"}
