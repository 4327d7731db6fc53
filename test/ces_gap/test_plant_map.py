"""Maps of speed, current and the plant's own spring: learnt from their data, once; a leak relaxes a friction force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from input_physics import FINE_S, TABLE, Brake, brakes, dahl, plain, recorded, series
from numba import njit

from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.library.leakage import TwoWayLeak
from ces_gap.plant_map import MAX_RECENT, RecentMaps, learn_map
from ces_gap.trace import Trace

LEAK = 3e-5  # [m/(s N)]


@njit(cache=True)
def leaky_brake(x, current, leak, step_s):
    """Friction with a leak in parallel: it moves by the stroke that has not leaked."""
    out = np.zeros_like(x)
    for k in range(1, len(x)):
        step = x[k] - x[k - 1] - leak * out[k - 1] * step_s
        out[k] = dahl(out[k - 1], step, current[k])
    return out


def leaking() -> Trace:
    trace = recorded(lambda x, v, i: leaky_brake(x, i, LEAK, FINE_S))
    return replace(trace, simulated=brakes(trace.inputs.position, trace.inputs.current))


def left(trace: Trace, leak: float) -> float:
    """RMS [N] of the gap with a leak, over the usable ticks."""
    force = Plant(Brake()).with_effects(Composition((Setting(TwoWayLeak(), (leak,)),)), trace)
    return float(np.sqrt(np.mean((trace.force - force)[trace.usable] ** 2)))


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
    assert trace.sprung_map is trace.sprung_map and trace.pumped_map is trace.pumped_map
    part, judged = replace(trace, usable=early), replace(trace, usable=trace.usable & ~early, map_ticks=early)
    np.testing.assert_array_equal(judged.sprung_map.map.table, part.sprung_map.map.table)
    assert not np.array_equal(judged.sprung_map.map.table, trace.sprung_map.map.table)


def test_a_leak_relaxes_a_friction_force() -> None:
    """Friction independent of speed is the hardest plant: the leak is found a fifth too small."""
    trace = leaking()
    shares = (0.0, 0.5, 0.8, 1.0, 1.5)
    errors = [left(trace, share * LEAK) for share in shares]
    assert shares[int(np.argmin(errors))] in (0.8, 1.0)
    assert min(errors) < 0.3 * errors[0]


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
