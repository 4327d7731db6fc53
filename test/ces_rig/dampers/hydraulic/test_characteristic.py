"""What a dyno shows: levels, asymmetry, loops, dissipation and response times as a CES damper has them."""

import numpy as np
import pytest
from dyno_measurements import current_step, cycle, rise_time, steady_force

from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.hydraulic.parameters import Damper, coefficients, parse_damper


def test_steady_levels_are_those_of_the_design():
    assert steady_force(Damper(), -0.4, 0.60) == pytest.approx(-2500.0, abs=250.0)
    assert steady_force(Damper(), 0.4, 0.60) == pytest.approx(1050.0, abs=150.0)


def test_force_rises_with_current_and_speed_either_way():
    for direction in (-1.0, 1.0):
        table = np.array(
            [[steady_force(Damper(), direction * v, i) for v in (0.2, 0.4, 0.8)] for i in (0.29, 0.4, 0.5, 0.6, 0.7)]
        )
        assert (np.diff(direction * table, axis=0) > 20.0).all()
        assert (np.diff(direction * table, axis=1) > 50.0).all()


def test_rebound_is_stiffer_than_compression_and_soft_several_times_softer():
    hard, soft = steady_force(Damper(), -0.4, 0.70), steady_force(Damper(), -0.4, 0.29)
    assert 2.0 < hard / -steady_force(Damper(), 0.4, 0.70) < 4.0
    assert 3.0 < hard / soft < 5.0


def test_force_grows_beyond_the_working_range_up_to_the_ends_of_the_allowed_one():
    for direction in (-1.0, 1.0):
        forces = [direction * steady_force(Damper(), direction * 0.3, i) for i in (0.20, 0.29, 0.70, 1.0, 1.6)]
        assert (np.diff(forces) > 50.0).all()
        below, above = (direction * steady_force(Damper(), direction * 0.3, i) for i in (0.0, 3.0))
        assert (below, above) == (forces[0], forces[-1])


def test_cracking_drop_continues_without_a_step_or_a_bend():
    c, step = coefficients(Damper()), 1e-5
    for end in (0.29, 0.70):
        below, at, above = (hy.cracking_drop(c, end + offset) for offset in (-step, 0.0, step))
        assert (at - below) == pytest.approx(above - at, rel=2e-3)
    assert hy.cracking_drop(c, 0.20) > 0.0


def test_characteristic_is_digressive():
    low, middle, high = (steady_force(Damper(), v, 0.6) for v in (-0.05, -0.15, -0.8))
    assert (middle - low) / 0.10 < 5 * (high - middle) / 0.65 < 0


@pytest.mark.parametrize("current", [0.29, 0.5, 0.7])
@pytest.mark.parametrize(("amplitude", "frequency"), [(0.018, 4.0), (0.006, 12.0), (0.001, 2.0)])
def test_a_cycle_takes_up_work(amplitude, frequency, current):
    loop = cycle(Damper(), amplitude, frequency, current)
    box = np.ptp(loop.stroke_m) * np.ptp(loop.force_N)
    work = np.trapezoid(np.append(loop.force_N, loop.force_N[0]), np.append(loop.stroke_m, loop.stroke_m[0]))
    assert 0.2 * box < work < box


def gap_at_rest(loop):
    """Force between the two branches of the loop where the speed is zero."""
    turns = np.flatnonzero(np.diff(np.sign(loop.speed_m_s)) != 0)
    return np.ptp(loop.force_N[turns])


def test_hysteresis_in_speed_grows_with_frequency():
    slow = gap_at_rest(cycle(Damper(), 0.018, 2.0, 0.5))
    fast = gap_at_rest(cycle(Damper(), 0.003, 12.0, 0.5))
    assert slow > 100.0
    assert fast > 1.3 * slow


def test_hysteresis_comes_from_elasticity():
    stiff = parse_damper(
        {"oil": {"air_fraction": 1e-4, "bulk_modulus_Pa": 4e9}, "mount": {"stiffness_N_m": 3e7}}, "stiff"
    )
    assert gap_at_rest(cycle(stiff, 0.006, 12.0, 0.6)) < 0.6 * gap_at_rest(cycle(Damper(), 0.006, 12.0, 0.6))


def test_step_of_current_acts_in_some_milliseconds():
    rise = rise_time(*current_step(Damper(), -0.2, 0.29, 0.70))
    fall = rise_time(*current_step(Damper(), -0.2, 0.70, 0.29))
    assert 0.010 < rise < 0.020
    assert 0.006 < fall < 0.8 * rise


def test_magnetic_hysteresis_shows_in_the_force():
    from_below, _ = current_step(Damper(), -0.2, 0.40, 0.50)
    from_above, _ = current_step(Damper(), -0.2, 0.60, 0.50)
    gap = from_above.force_N[-1] - from_below.force_N[-1]
    assert -300.0 < gap < -40.0  # more pressure, so more rebound force, coming from above
    without = parse_damper({"ces_valve": {"hysteresis_A": 0.0}}, "no loop")
    runs = [current_step(without, -0.2, start, 0.50)[0].force_N[-1] for start in (0.40, 0.60)]
    assert abs(runs[1] - runs[0]) < 0.1 * abs(gap)


def test_seal_sticks_before_it_slides():
    loop = cycle(Damper(), 40e-6, 1.0, 0.5)
    slope = np.polyfit(loop.stroke_m, loop.force_N, 1)[0]
    sliding = cycle(Damper(), 0.01, 1.0, 0.5)
    assert slope > 20 * np.polyfit(sliding.stroke_m, sliding.force_N, 1)[0]
    assert slope > 2e5
