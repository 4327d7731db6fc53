"""The ticks of hydraulic networks against their equations, solved slowly, and against values by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from random import Random

import numpy as np
import pytest
from hydraulic_models import GROOVE, hydraulic_model, make_hydraulic, random_hydraulic
from physical_models import LINEAR, NO_SIDE, PLAIN_VALVE, hostile_inputs, straight
from physical_twins import hydraulic_forces, settings
from samplings import make_sampling

from ces_observer.structures.curves import Bypass, IncreasingCurve
from ces_observer.structures.hydraulic import EDGES, LONG_TICK, FrictionElement, ValvePath
from ces_observer.structures.structure import OperatingRange
from ces_observer.tick.edges import EDGE_DROPS, EDGE_FLOWS, EDGE_SHARE
from ces_observer.tick.hydraulic import GAS_POSITIONS, check_hydraulic
from ces_observer.tick.model import N_STRUCTURE
from ces_observer.tick.mount import MOUNT_HELD, WAY_SHARE, WAY_SHIFT, begin_mount, find_piece_of_way
from ces_observer.tick.pressures import (
    BYPASS_LOGARITHMS,
    BYPASS_NODES,
    BYPASS_POSITIONS,
    LAMINAR,
    NARROW,
    PRESSURE_C,
    PRESSURE_R,
    RATIO,
    WARMING_S,
)
from ces_observer.tick.valve import KEEP, SETTING, VALVE_CURRENTS, VALVE_RISE

VALVE = ValvePath(IncreasingCurve((0.1, 0.4, 0.9), (0.0, 0.3, 1.0)), 0.3, 0.02, 8e-3, 5e-3)
USUAL = make_hydraulic(VALVE)
NETWORKS = {
    "twin tube": USUAL,
    "uniflow": replace(USUAL, kind="uniflow", piston=USUAL.base, base=straight(900.0), external=USUAL.piston),
    "groove, soft gas": replace(USUAL, kind="monotube", compression_m_N=3e-5, mount_m_N=0.0, bypass=GROOVE),
    "linear": LINEAR,
}
CLOSED = replace(LINEAR, **dict.fromkeys(EDGES, straight(1e9)), mount_m_N=0.0, creep_m_Ns=0.0)
INTERVAL = 1e-3


def swing(count=60):
    """Yield a lively course within the envelope."""
    for k in range(count):
        yield 0.015 * math.sin(0.2 * k), 0.6 * math.cos(0.23 * k) ** 3, 0.5 + 0.3 * math.sin(0.3 * k)


def pressures(run):
    return run.s[PRESSURE_C], run.s[PRESSURE_R]


def pressures_after(run, position, speed, current):
    run.tick(position, speed, current)
    return pressures(run)


def valve_run(path, interval=INTERVAL):
    """Return the setting of a valve as a function of the next current."""
    run = replace(LINEAR, valve=path).make_predictor(replace(LONG_TICK, rate_Hz=1.0 / interval))

    def tick(current):
        run.tick(0.0, 0.0, current)
        return run.s[SETTING]

    return tick


def agree(model, inputs):
    inputs = list(inputs)
    run = model.make_predictor()
    found, expected = [run.tick(*one) for one in inputs], hydraulic_forces(model, inputs)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(map(abs, expected)))


@pytest.mark.parametrize("name", NETWORKS)
def test_networks_follow_their_equations(name):
    agree(hydraulic_model(NETWORKS[name]), swing())


@pytest.mark.parametrize("seed", range(10))
def test_random_networks_follow_their_equations_on_hostile_inputs(seed):
    random = Random(seed)
    model = hydraulic_model(random_hydraulic(random), make_sampling(random.choice((200.0, 1000.0, 4000.0))))
    agree(replace(model, force_envelope_N=(-1e300, 1e300)), hostile_inputs(model, random, 40))


@pytest.mark.parametrize(("current", "drop"), [(0.1, 300.0), (0.9, 1500.0)])
def test_steady_pressures_are_those_of_the_flows(current, drop):
    """At w = 1 m/s, 0.4 - E pass the base, 1 + E the piston: 1000 (0.4 - E) = drop E + 200 (1 + E)."""
    external = 200.0 / (1200.0 + drop)
    model = hydraulic_model(replace(LINEAR, valve=replace(PLAIN_VALVE, characteristic=VALVE.characteristic)))
    run = model.make_predictor()
    force = [run.tick(0.0, 1.0, current) for _ in range(300)][-1]
    way = 1.0 - 2e-6 * force  # behind a mount that creeps
    assert pressures(run) == pytest.approx((way * 1000.0 * (0.4 - external), way * drop * external), rel=1e-9)
    assert force == pytest.approx(way * (1400.0 * (0.4 - external) - drop * external), rel=1e-9)
    assert model.body.steady_force(model.operating_range, 1.0, current) == pytest.approx(force, rel=1e-6)


@pytest.mark.parametrize(("yields", "held", "rubbed"), [((), 0.0, 0.0), ((1e3,), 1e3, 0.0), ((20.0, 1e3), 1e3, 20.0)])
def test_the_first_step_is_that_of_compliances_and_slopes(yields, held, rubbed):
    """w = d - give (s + held w + rubbed): springs that do not yield stiffen what is behind the mount."""
    side = replace(NO_SIDE, friction=tuple(FrictionElement(1e6, one) for one in yields))
    run = hydraulic_model(replace(LINEAR, side=side)).make_predictor()
    give = 3e-7 / INTERVAL + 2e-6
    mount, drive = give / (1.0 + give * held), (0.5 - give * rubbed) / (1.0 + give * held)
    across, base, external = 1.0 / 200.0, 1.0 / 1000.0, 1.0 / 300.0
    matrix = [
        [2e-7 / INTERVAL + 1.4**2 * mount + across + base, -1.4 * mount - across],
        [-1.4 * mount - across, 1e-7 / INTERVAL + mount + across + external],
    ]
    expected = np.linalg.solve(matrix, [1.4 * drive, -drive])
    assert pressures_after(run, 0.0, 0.5, 0.0) == pytest.approx(tuple(expected), rel=1e-12)


def test_a_void_must_be_refilled():
    """All valves are closed: what the rod drew out of the oil at next to no pressure, it presses back."""
    run = hydraulic_model(replace(CLOSED, reservoir_N=100.0, air=5.0, most_N=1e6)).make_predictor()
    drawn = [pressures_after(run, 0.0, -0.5, 0.0)[0] for _ in range(20)]
    pressed = [pressures_after(run, 0.0, 0.5, 0.0)[0] for _ in range(20)]
    assert -95.0 > drawn[3] > drawn[-1] > -130.0
    assert pressed[9] < -95.0 and pressed[-1] == pytest.approx(0.0, abs=5.0)


def test_a_chamber_that_is_shorter_is_stiffer():
    """All valves are closed: the same volume has the higher pressure the smaller the compliance."""
    run = hydraulic_model(replace(CLOSED, compression_growth_1_m=-50.0)).make_predictor()
    first = pressures_after(run, 0.0, 0.1, 0.0)
    after = pressures_after(run, 0.01, 0.0, 0.0)
    assert after == pytest.approx((math.exp(0.5) * first[0], first[1]), rel=1e-4)


def test_a_valve_that_closes_late_passes_oil_back():
    """The flow out leaves the opening y; on the way back it adds y root(drop) to that of the steady curve."""
    quick, late = (hydraulic_model(replace(LINEAR, mount_m_N=0.0, base_s=lag)).make_predictor() for lag in (0.0, 0.02))
    forces = [[run.tick(0.0, v, 0.5) for v in (1.0,) * 200 + (-1.0,) * 200] for run in (quick, late)]
    assert forces[0][199] == pytest.approx(forces[1][199], rel=1e-3)
    assert forces[0][-1] == pytest.approx(forces[1][-1], rel=1e-3)
    assert pressures(quick) == pytest.approx(pressures(late), rel=1e-3)
    assert max(abs(a - b) for a, b in zip(*forces, strict=True)) > 20.0


def test_a_bypass_opens_where_the_stroke_says():
    model = hydraulic_model(replace(LINEAR, bypass=Bypass((-0.01, 0.0, 0.01), (1e-3, 0.05, 1e-3))))
    forces = [model.make_predictor().tick(x, 0.5, 0.5) for x in (-0.015, -0.01, -0.005, 0.0, 0.005, 0.01)]
    assert forces[0] == forces[1] == forces[5] > forces[2] == forces[4] > forces[3]


def test_a_bypass_moves_with_the_mount():
    """All else is closed: a flow of u times the opening has the drop u^2 + sqrt(n) u."""
    bypass = Bypass((-0.02, 0.02), (0.05 * math.exp(-2.0), 0.05 * math.exp(2.0)))
    run = replace(CLOSED, area_ratio=0.0, bypass=bypass, mount_m_N=1e-5).make_predictor(LONG_TICK)
    force = 0.0
    for x in (0.01, 0.003, 0.003):
        u = 0.5 / (0.05 * math.exp(100.0 * (x - 1e-5 * force)))
        force = run.tick(x, 0.5, 0.5)
        assert force == pytest.approx(u**2 + math.sqrt(30.0) * u, rel=1e-5)


@pytest.mark.parametrize("fade", [1e-3, -1e-3, 1.0, -1.0])
def test_heat_grows_the_flows_with_its_lag_up_to_a_limit(fade):
    """Ticks as long as the lag take up half of the power; flows that are straight share their growth with the force."""
    body = replace(LINEAR, fade_1_W=fade, mount_m_N=0.0, creep_m_Ns=0.0)
    run = body.make_predictor(replace(LONG_TICK, rate_Hz=1.0 / WARMING_S))
    heat, first = 0.0, run.tick(0.0, 1.0, 0.5)
    force = first
    for _ in range(4):
        heat = 0.5 * heat + 0.5 * force
        force = run.tick(0.0, 1.0, 0.5)
        assert force == pytest.approx(first * math.exp(-min(max(fade * heat, -2.0), 2.0)), rel=1e-5)


def test_a_force_moves_a_mount_that_creeps():
    """All valves are closed: the motion is that of the mount, at creep times the force."""
    run = hydraulic_model(replace(CLOSED, creep_m_Ns=2e-6)).make_predictor()
    assert [run.tick(0.0, 1e-3, 0.5) for _ in range(400)][-1] == pytest.approx(1e-3 / 2e-6, rel=1e-3)


def test_springs_behind_a_mount_yield_whatever_their_numbers():
    springs = [FrictionElement(*one) for one in product((1e-9, 1e5, 1e12), (0.0, 20.0, 1e9))]
    for give, left, *some in product((0.0, 1e-7, 1.0), (-1e9, -0.3, 0.0, 1e-12, 1e6), springs, springs):
        body = replace(LINEAR, mount_m_N=give, creep_m_Ns=0.0, side=replace(NO_SIDE, friction=tuple(some)))
        p, n, s, k = body.lay_out(replace(LONG_TICK, rate_Hz=1.0 / INTERVAL)).arrays()
        begin_mount(p, n, s, 0.0, 0.0)
        find_piece_of_way(p, n, s, k, left)
        way = s[WAY_SHARE] * (left + s[WAY_SHIFT])
        rubbed = sum(min(max(INTERVAL * one.stiffness_N_m * way, -one.yield_N), one.yield_N) for one in some)
        assert way + give / INTERVAL * rubbed == pytest.approx(left, rel=1e-9)


def test_friction_grows_with_the_rebound_pressure_alone():
    side = replace(NO_SIDE, friction=(FrictionElement(1e6, 20.0),))
    rubbing = hydraulic_model(replace(LINEAR, creep_m_Ns=0.0, side=side, friction_growth_1_N=1e-3)).make_predictor()
    plain = hydraulic_model(replace(LINEAR, creep_m_Ns=0.0)).make_predictor()
    for speed, sign in ((-1.0, -1.0), (1.0, 1.0)):
        with_it, without = ([run.tick(0.0, speed, 0.9) for _ in range(300)][-1] for run in (rubbing, plain))
        grown = 1.0 + 1e-3 * max(pressures(plain)[1], 0.0)
        assert with_it - without == pytest.approx(sign * 20.0 * grown)


def test_pressures_are_held_and_forget_what_was_beyond():
    run = hydraulic_model(replace(LINEAR, most_N=50.0)).make_predictor()
    held = [run.tick(0.0, 2.0, 0.5) for _ in range(100)]
    assert pressures(run) == (50.0, -50.0) or max(map(abs, pressures(run))) == 50.0
    assert max(held) <= 1.4 * 50.0 + 50.0
    again = hydraulic_model(replace(LINEAR, most_N=50.0)).make_predictor()
    for _ in range(50):
        a, b = run.tick(0.0, 0.05, 0.5), again.tick(0.0, 0.05, 0.5)
    assert a == pytest.approx(b, rel=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_a_step_has_one_solution_wherever_the_search_begins(seed):
    random = Random(seed)
    model = hydraulic_model(random_hydraulic(random))
    run = model.make_predictor()
    for one in hostile_inputs(model, random, 100):
        other = model.make_predictor()
        other.s[:], other.k[:] = run.s, run.k
        size = 10.0 ** random.uniform(0.0, 5.0)
        other.s[PRESSURE_C], other.s[PRESSURE_R] = random.uniform(-size, size), random.uniform(-size, size)
        force = run.tick(*one)
        assert other.tick(*one) == pytest.approx(force, rel=1e-7, abs=1e-7 * max(map(abs, pressures(run))))


def test_a_reset_brings_the_run_back_to_new():
    model = hydraulic_model(make_hydraulic(VALVE, bypass=GROOVE))
    run, new = model.make_predictor(), model.make_predictor()
    for one in hostile_inputs(model, Random(1), 50):
        run.tick(*one)
    assert run.tick(0.0, math.nan, 0.5) == math.inf
    run.reset()
    assert not run.clamped
    assert [run.tick(*one) for one in swing()] == [new.tick(*one) for one in swing()]


def test_a_restart_is_soon_forgotten():
    """Chambers begin at the reservoir's pressure, valves closed, wherever the stroke is."""
    model = hydraulic_model(USUAL)
    course = [(0.015 * math.sin(0.02 * k), 0.3 * math.cos(0.02 * k), 0.5) for k in range(1000)]
    whole, part = model.make_predictor(), model.make_predictor()
    forces = [whole.tick(*one) for one in course]
    assert [part.tick(*one) for one in course[250:]][400:] == pytest.approx(forces[650:], abs=0.5)


def test_inputs_are_extrapolated_within_reach_and_clamped_beyond():
    model = hydraulic_model(replace(LINEAR, reach=1.5))
    runs = [model.make_predictor() for _ in range(4)]
    inside, outside, end, beyond = (run.tick(0.0, v, 0.5) for run, v in zip(runs, (1.4, 2.0, 2.1, 9.0), strict=True))
    assert inside < outside < end == beyond
    assert [run.clamped for run in runs] == [False, True, True, True]


def test_a_force_outside_its_envelope_is_held():
    run = LINEAR.make_predictor(OperatingRange(1000.0, hydraulic_model(LINEAR).envelope.by_signal, (-10.0, 10.0)))
    assert ([run.tick(0.0, 1.0, 0.5) for _ in range(20)][-1], run.held) == (10.0, True)
    run.reset()
    assert not run.held


def test_a_step_of_current_is_delayed_by_ticks_and_parts_of_them():
    tick = valve_run(replace(PLAIN_VALVE, delay_ticks=2.25))
    assert [tick(current) for current in (0.2, 1.0, 1.0, 1.0, 1.0, 1.0)] == pytest.approx(
        [0.2, 0.2, 0.2, 0.8, 1.0, 1.0]
    )


def test_a_rising_setting_lags_otherwise_than_a_falling_one():
    tick = valve_run(replace(PLAIN_VALVE, rise_s=3e-3, fall_s=1e-3))
    assert [tick(current) for current in (0.0, 1.0, 1.0)] == pytest.approx([0.0, 0.25, 0.4375])
    assert [tick(0.0) for _ in range(2)] == pytest.approx([0.4375 / 2.0, 0.4375 / 4.0])


def test_remanence_is_the_mean_of_three_plays():
    """Half widths 0.1, 0.3 and 0.5: at 1 they are pulled to 0.9, 0.7 and 0.5; at 0.6 only the first is pushed back."""
    tick = valve_run(replace(PLAIN_VALVE, hysteresis_A=0.3))
    assert [tick(current) for current in (0.0, 1.0)] == pytest.approx([0.0, 0.7])
    assert tick(0.6) == pytest.approx((0.7 + 0.7 + 0.5) / 3.0)
    assert tick(0.0) == pytest.approx((0.1 + 0.3 + 0.5) / 3.0)


def test_a_characteristic_is_constant_beyond_its_ends():
    path = replace(PLAIN_VALVE, characteristic=IncreasingCurve((0.2, 0.5, 0.8), (0.0, 0.2, 1.0)))
    for current, setting in ((-5.0, 0.0), (0.2, 0.0), (0.35, 0.1), (0.65, 0.6), (0.8, 1.0), (1.5, 1.0)):
        assert valve_run(path)(current) == pytest.approx(setting)
        assert path.steady(current) == pytest.approx(setting)


def test_the_valve_follows_its_reference_on_hostile_currents():
    for seed in range(20):
        random = Random(seed)
        model = hydraulic_model(random_hydraulic(random))
        currents = [min(max(one[2], -1.0), 2.0) for one in hostile_inputs(model, random, 200)]
        tick, kept = valve_run(model.body.valve), math.exp(-1e-3 / LINEAR.relax_s)
        assert [tick(c) for c in currents] == pytest.approx(settings(model.body.valve, currents, 1e-3, kept), abs=1e-12)


def checked(p, n, s, k):
    return check_hydraulic(p, n, len(p), len(n), len(s), len(k))


@pytest.mark.parametrize("seed", range(20))
def test_arrays_of_a_model_are_accepted_and_places_outside_them_refused(seed):
    model = hydraulic_model(random_hydraulic(Random(seed)))
    p, n, s, k = model.body.lay_out(model.operating_range).arrays()
    assert checked(p, n, s, k)
    sizes = np.array([len(p), len(n), len(s), len(k)])
    for shorter in np.eye(4, dtype=int):
        assert not check_hydraulic(p, n, *(sizes - shorter))
    for place in range(N_STRUCTURE, len(n)):
        for wrong in (-1, 2**62):
            changed = [*n[:place], wrong, *n[place + 1 :]]
            unused = place in (BYPASS_POSITIONS, BYPASS_LOGARITHMS) and not n[BYPASS_NODES]
            assert checked(p, changed, s, k) == unused, place


def test_a_share_above_one_is_not_kept():
    p, n, s, k = USUAL.lay_out(hydraulic_model(USUAL).operating_range).arrays()
    assert not checked([*p[:KEEP], 1.01, *p[KEEP + 1 :]], n, s, k)


@pytest.mark.parametrize("place", [LAMINAR, NARROW, RATIO, MOUNT_HELD, VALVE_RISE, EDGE_SHARE])
def test_numbers_by_which_the_tick_divides_are_above_zero(place):
    model = hydraulic_model(USUAL)
    p, n, s, k = model.body.lay_out(model.operating_range).arrays()
    assert not checked([*p[:place], 0.0, *p[place + 1 :]], n, s, k)


@pytest.mark.parametrize("table", [EDGE_FLOWS, EDGE_DROPS, VALVE_CURRENTS, GAS_POSITIONS])
def test_nodes_that_do_not_rise_are_refused(table):
    model = hydraulic_model(USUAL)
    p, n, s, k = model.body.lay_out(model.operating_range).arrays()
    p[n[table] + 1] = p[n[table]]
    assert not checked(p, n, s, k)
