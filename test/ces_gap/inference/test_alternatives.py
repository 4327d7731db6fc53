"""Alternatives: effects that can replace one of the best composition, or that a recalibration would explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from engine_plant import F, traced
from example_effects import Spring
from search_examples import EFFECTS, FRICTION, OFFSET, SPRING, Offset, planted, run_search

from ces_gap.effects.effect import Effect, EffectParameter, Setting
from ces_gap.effects.library import library_effect
from ces_gap.effects.simulation_errors import ForceMap
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import Refinement
from ces_gap.inference.search import (
    MAX_ALIKE_SHARE,
    EffectSearchResult,
    find_absorbed_effects,
    find_alternatives,
    interchangeable_effects,
    merge_groups,
    min_unexplained_shares,
    search,
)
from ces_gap.inference.verdict import NEGLIGIBLE_SHARE
from ces_gap.trace import Trace, TraceInputs


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
    assert NEGLIGIBLE_SHARE < share < MAX_ALIKE_SHARE  # the difference is visible in both
    groups = [set(group) for group in interchangeable_effects(result)]
    assert groups == ([{"current_scale", "force_scale"}] if constant_A else [])


@pytest.mark.parametrize("effects", [(SPRING,), (SPRING, FRICTION)], ids=["one", "two"])
def test_distinguishable_effects_are_not_interchangeable(effects: tuple) -> None:
    result = run_search(planted(*effects))
    assert interchangeable_effects(result) == () and find_alternatives(result)
    shares = min_unexplained_shares(result)
    assert min(shares[n] for n in shares if n not in {s.name for s in effects}) > NEGLIGIBLE_SHARE


def test_groups_and_classes_are_merged_without_subsets() -> None:
    assert merge_groups((("b", "c"),), (("a", "b", "c"), ("d", "e"))) == (("a", "b", "c"), ("d", "e"))
    assert merge_groups((("b", "a"),), (("a", "b"),)) == (("b", "a"),)
    assert merge_groups((), ()) == ()


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
