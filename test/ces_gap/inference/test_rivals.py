"""Rivals: who can stand in for an effect that was found, the rest refitted beside it, is told; who cannot is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from engine_plant import NOISE_N
from test_search import EFFECTS, FRICTION, OFFSET, PLANT, SPRING, EffectSearchResult, Offset, planted, searched

from ces_gap.effects.effect import EffectParameter
from ces_gap.inference.alternatives import (
    find_alternatives,
    interchangeable_effects,
    merge_groups,
    min_unexplained_shares,
)
from ces_gap.inference.anchored_surrogate import Refinement
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.search import search
from ces_gap.inference.verdict import NEGLIGIBLE_SHARE
from ces_gap.trace import Trace, TraceInputs


class Tare(Offset):
    """The same constant by another name, but for a trend nobody could see."""

    name, form = "tare", "creeping"
    parameters = (EffectParameter("tare_N", -500.0, 500.0, (10.0,), "offset", magnitude=True),)

    def respond(self, trace: Trace, inputs: TraceInputs, force: np.ndarray, values: object) -> np.ndarray:
        return np.asarray(super().respond(trace, inputs, force, values) + 1e-3 * trace.time_s)  # type: ignore[arg-type]


def with_tare(evidence: Evidence) -> EffectSearchResult:
    return search(evidence, (*EFFECTS, Tare()), Refinement(), 1)


def test_one_that_replaces_an_effect_beside_others_stands_in_for_it() -> None:
    found = with_tare(planted(OFFSET, FRICTION))
    assert found.best is not None and len(found.best.effects) == 2 and "friction" in found.best.names
    group = next(g for g in interchangeable_effects(found) if g[0] != "friction")
    assert set(group) == {"offset", "tare"} and group[0] in found.best.names
    left = min_unexplained_shares(found)
    assert left["offset"] == pytest.approx(left["tare"], abs=0.01)
    alone = {f.names[0]: (f.cost - len(found.baseline_residual)) / found.gap_energy for f in found.alone}
    assert left["tare"] < 0.05 < alone["tare"]  # alone it leaves the friction as well


def test_for_a_single_effect_those_alone_are_the_rivals() -> None:
    found = with_tare(planted(OFFSET))
    assert {frozenset(g) for g in interchangeable_effects(found)} == {frozenset(("offset", "tare"))}
    assert all(len(f.names) == 1 for f in find_alternatives(found))


@pytest.mark.parametrize("there", [(SPRING,), (SPRING, FRICTION)], ids=["one", "two"])
def test_what_the_data_tell_apart_does_not_stand_in(there: tuple) -> None:
    found = searched(planted(*there))
    assert interchangeable_effects(found) == () and find_alternatives(found)
    left = min_unexplained_shares(found)
    assert min(left[n] for n in left if n not in {s.name for s in there}) > NEGLIGIBLE_SHARE


def test_without_a_cause_nothing_stands_in() -> None:
    found = searched(planted())
    assert found.best is None and interchangeable_effects(found) == () and find_alternatives(found) == []


def test_one_that_differs_in_two_effects_is_no_contender() -> None:
    found = searched(planted(SPRING, FRICTION))
    assert found.best is not None
    other = next(f for f in found.tried if f.names != found.best.names)
    both = replace(other, effects=tuple(e for e in EFFECTS if e.name in ("offset", "current_offset")))
    assert both not in find_alternatives(replace(found, tried=(both,)))


def test_groups_join_classes_and_parts_of_others_are_left_out() -> None:
    assert merge_groups((("b", "c"),), (("a", "b", "c"), ("d", "e"))) == (("a", "b", "c"), ("d", "e"))
    assert merge_groups((("b", "a"),), (("a", "b"),)) == (("b", "a"),)
    assert merge_groups((), ()) == ()


def test_these_rivals_are_told_in_noise_of_the_usual_strength() -> None:
    assert planted(OFFSET).noise.rms_N == NOISE_N and PLANT.correction is None
