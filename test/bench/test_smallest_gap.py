"""The smallest gap that a diagnosis finds: damper, ladder, rows, tables, and a real diagnosis."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hydraulic_models import hydraulic_model, make_hydraulic
from physical_examples import make_valve
from programs import ONE_KIND

from bench.gaps.ladder_damper import (
    AUTO,
    GAPS_N,
    NONE,
    POLYNOMIAL,
    REAL,
    REFERENCE,
    LadderDamper,
    LadderRow,
    RowFile,
    smallest_N,
    tables,
)
from bench.gaps.smallest_gap import EFFECTS, Ladder, find_cause, identify_model
from ces_gap.diagnosis import NO_GAP
from ces_gap.effects.library import library
from ces_identify.polynomial.search_limits import Limits
from ces_identify.simulations.simulation import ModelSimulation
from ces_rig.dampers.effects import EFFECTS as LIBRARY_EFFECTS

ROW = LadderRow("bouc_wen:1", POLYNOMIAL, "polynomial_narx", "friction", 4, 8.0, "named", "friction", 50.0, 40.0)


def row(rung, verdict="named", first="friction", **others):
    return replace(ROW, rung=rung, gap_N=GAPS_N[rung], verdict=verdict, first=first, **others)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def damper():
    return LadderDamper.draw("bouc_wen", 1, new_s=10.0, real_s=5.0)


def test_the_gap_is_about_as_large_as_its_rung_in_the_same_noise(damper):
    assert set(EFFECTS) <= set(LIBRARY_EFFECTS)
    effect = damper.draw_effect("friction")
    for target_N in (10.0, 40.0):
        changed = damper.with_effect(effect, target_N)
        assert changed.gap_N == pytest.approx(target_N, rel=0.3)
    pairs = list(zip(damper.new(REAL), changed.real, strict=True))
    assert all(np.array_equal(a.channel("position").values, b.channel("position").values) for a, b in pairs)
    added = np.concatenate([b.channel("force").values - a.channel("force").values for a, b in pairs])
    assert rms(added) == pytest.approx(changed.gap_N, rel=0.02)


@pytest.mark.slow
def test_a_diagnosis_finds_a_large_effect_and_none_where_there_is_none(damper, monkeypatch):
    few = [effect for effect in library() if effect.name in ("friction", "gas_spring", "inertia")]
    monkeypatch.setattr("ces_gap.pipeline.library", lambda: few)
    monkeypatch.setattr(*ONE_KIND)
    simulation = ModelSimulation(identify_model(damper, "hydraulic", Limits(threads=1, work=0.1)))
    reference = damper.new(REFERENCE)
    nothing = find_cause(simulation, damper.without_effect(1), reference)
    assert nothing.verdict == NO_GAP
    assert nothing.corrected_N < nothing.error_N
    large = find_cause(simulation, damper.with_effect(damper.draw_effect("friction"), 90.0), reference)
    assert large.verdict != NO_GAP
    assert large.first == "friction"


def test_bisection_finds_the_lowest_rung_from_rows_that_exist(damper, tmp_path):
    rows, passes_from = RowFile(tmp_path / "rows.jsonl"), 5
    for rung in range(len(GAPS_N)):
        rows.append(row(rung, "named" if rung >= passes_from else NO_GAP))
    model = hydraulic_model(make_hydraulic(make_valve()))
    ladder = Ladder(damper, ROW.damper, model, POLYNOMIAL, "friction", RowFile(rows.path))
    for first in (0, 5, 13):
        assert ladder.search(lambda one: one.finds_gap, first) == passes_from
    assert ladder.search(lambda one: one.first == "leakage", 3) == len(GAPS_N)


def test_the_smallest_gap_is_above_every_miss():
    rows = [row(2, NO_GAP), row(3), row(4, NO_GAP), row(5), row(9)]
    assert smallest_N(rows, lambda one: one.finds_gap) == GAPS_N[5]
    for unfinished in ([row(9, NO_GAP)], [row(4, NO_GAP), row(6)]):
        assert math.isnan(smallest_N(unfinished, lambda one: one.finds_gap))


def test_tables_compare_both_simulations():
    rows = [row(8), row(7, first="leakage"), row(6, NO_GAP)]
    rows += [row(6, simulation=AUTO, structure="hydraulic"), row(5, NO_GAP, simulation=AUTO, structure="hydraulic")]
    rows += [row(0, NO_GAP, effect=NONE)]
    lines = tables(rows).splitlines()
    assert "| bouc_wen:1 | polynomial (polynomial_narx) | 50.0 | 40.0 | 0 of 1 |" in lines
    assert "| bouc_wen:1, friction | 22.6 (2.8×) | 16.0 (2.0×) | 0.71 | 32.0 (4.0×) | 16.0 (2.0×) | 0.50 |" in lines
    assert "| median ratio (of pairs) |  |  | 0.71 (1) |  |  | 0.50 (1) |" in lines
