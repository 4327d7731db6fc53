"""Maps of speed, current and the plant's own spring: learnt from their data, once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from input_physics import TABLE, plain, recorded, series

from ces_gap.plant_map import MAX_RECENT, RecentMaps, learn_map


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [9.5e5, 5e6])
def test_the_spring_of_a_plant_is_identified(stiffness: float) -> None:
    trace = recorded(series(TABLE / stiffness))
    found = replace(trace, simulated=trace.force).sprung_map.compliance
    assert 0.5 < found * stiffness < 2.0  # compliances are tried by factors of 1.8


def test_a_plant_without_a_spring_has_none() -> None:
    assert plain().sprung_map.compliance == 0.0


def test_a_map_is_learnt_once_for_a_trace_from_its_map_ticks() -> None:
    trace = plain()
    early = trace.usable & (trace.time_s < 0.5 * trace.time_s[-1])
    assert trace.sprung_map is trace.sprung_map
    part, judged = replace(trace, usable=early), replace(trace, usable=trace.usable & ~early, map_ticks=early)
    np.testing.assert_array_equal(judged.sprung_map.map.table, part.sprung_map.map.table)
    assert not np.array_equal(judged.sprung_map.map.table, trace.sprung_map.map.table)


TICKS = 2000


def test_only_other_data_are_learnt_again() -> None:
    rng = np.random.default_rng(1)
    speed, current, usable = rng.standard_normal(TICKS), rng.random(TICKS), np.ones(TICKS, bool)
    force, maps = 100.0 * np.tanh(speed) * (1.0 + current), RecentMaps()
    first = maps.learn(speed, current, force, usable)
    assert maps.learn(speed.copy(), current, force.copy(), usable) is first
    for other in range(1, MAX_RECENT + 1):
        changed = force.copy()
        changed[-1] += other
        expected = learn_map(speed, current, changed, usable)
        np.testing.assert_array_equal(maps.learn(speed, current, changed, usable).table, expected.table)
    again = maps.learn(speed, current, force, usable)
    assert again is not first  # only the last few are kept
    np.testing.assert_array_equal(again.table, first.table)
