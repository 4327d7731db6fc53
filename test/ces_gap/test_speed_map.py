"""Maps of speed and current: the same data give the map that was learnt from them before, other data another."""

from __future__ import annotations

import numpy as np

from ces_gap.plant_map import MAX_RECENT, RecentMaps, learn_map

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
