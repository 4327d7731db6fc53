"""The hydraulic damper: its parameters, the kernel's physics, what a dyno shows of it, and its stepper."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from dyno_measurements import current_step, cycle, rise_time, steady_force

from bench.parameter_table import as_yaml, rows
from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.hydraulic.kernel import STEP_S
from ces_rig.dampers.hydraulic.parameters import Damper, HydraulicDamper, coefficients, load_damper, parse_damper
from ces_rig.dampers.stepper import DamperStepper, simulate, spline_speed
from ces_rig.errors import RigError

PACKAGED = Path(str(files("ces_rig.dampers.hydraulic"))) / "damper.yaml"


def test_the_packaged_file_is_the_default_damper():
    assert load_damper(PACKAGED) == Damper()
    assert PACKAGED.read_text(encoding="utf-8") == as_yaml()


def test_one_key_of_a_check_valve_may_be_given_alone():
    damper = parse_damper({"top_checks": {"compression": {"closing_s": 0.004}}}, "x")
    assert damper.top_checks.compression.closing_s == 0.004
    assert damper.top_checks.compression.area_m2 == Damper().top_checks.compression.area_m2
    assert damper.piston == Damper().piston


def test_every_parameter_reaches_the_kernel():
    base = coefficients(Damper())
    special = {"half_stroke_m", "start_degC"}  # start: in the state; half stroke: below
    for path, default, one in rows():
        if path.rpartition(".")[2] in special:
            continue
        mapping = default * 1.01 if default else 0.5 * one.high
        for key in reversed(path.split(".")):
            mapping = {key: mapping}
        assert coefficients(parse_damper(mapping, "x")) != base, path
    assert coefficients(parse_damper({"body": {"half_stroke_m": 0.05}}, "x")) != base


def test_every_parameter_has_a_unit_and_lies_inside_its_range():
    for path, value, one in rows():
        assert one.unit and one.meaning and one.low <= value <= one.high, path


def test_words_that_are_numbers_are_taken(tmp_path):
    path = tmp_path / "d.yaml"
    path.write_text("reservoir: {pressure_Pa: 8e5}\n")  # YAML 1.1 reads 8e5 as a word
    assert load_damper(path).reservoir.pressure_Pa == 8e5


GRID = 0.5e-3


def drive(seconds=2.0, amplitude=0.018, frequency=4.0):
    time = np.arange(0, seconds, GRID)
    rise = np.clip(time / 0.3, 0, 1)
    stroke = amplitude * rise**2 * (3 - 2 * rise) * np.sin(2 * np.pi * frequency * time)
    return time, stroke, 0.495 + 0.2 * np.sin(2 * np.pi * 3.1 * time)


def mass(damper, run):
    c = coefficients(damper)
    names = ("piston_m", "p_compression_Pa", "p_rebound_Pa", "p_gas_Pa")
    columns = np.array([run.state(name) for name in names]).T
    return np.array([hy.oil_mass(c, *row) for row in columns])


def relative_rms(a, b):
    return np.sqrt(np.mean((a - b) ** 2)) / np.std(b)


def test_oil_is_conserved():
    _, stroke, current = drive()
    runs = [simulate(HydraulicDamper(Damper()), GRID, stroke, current, step_s=h) for h in (STEP_S, STEP_S / 2)]
    astray = [np.ptp(mass(Damper(), run)) for run in runs]
    # about 0.3 kg/s flow to and fro; what goes astray is the integrator's error alone, so it falls with the step
    assert astray[0] < 2e-6
    assert astray[1] < 0.4 * astray[0]


@pytest.mark.slow
def test_order_of_convergence():
    _, stroke, current = drive(0.5)
    reference = simulate(HydraulicDamper(Damper()), GRID, stroke, current, step_s=GRID / 160).force_N
    coarse, fine = (
        relative_rms(simulate(HydraulicDamper(Damper()), GRID, stroke, current, step_s=GRID / n).force_N, reference)
        for n in (10, 20)
    )
    assert 3.5 < coarse / fine < 4.5  # second order
    assert pytest.approx(GRID / 10) == STEP_S and coarse < 0.002, "the step that is used"


def test_pressures_stop_at_the_vapour_floor():
    damper = parse_damper({"reservoir": {"pressure_Pa": 1.1e5}}, "thin gas")
    time = np.arange(0, 1.0, GRID)
    stroke = 0.035 * np.clip(time / 0.2, 0, 1) ** 3 * np.sin(2 * np.pi * 10 * time)
    run = simulate(HydraulicDamper(damper), GRID, stroke, np.full_like(time, 0.6))
    lowest = run.state("p_compression_Pa").min()
    assert hy.LOWEST_PA < lowest < 1.3 * damper.oil.vapour_pressure_Pa
    assert np.isfinite(run.force_N).all()
    assert np.ptp(mass(damper, run)) < 1e-3 * mass(damper, run)[0]
    full = simulate(HydraulicDamper(Damper()), GRID, stroke, np.full_like(time, 0.6))
    assert full.state("p_compression_Pa").min() > 3e5  # the gas pressure prevents it


def test_force_grows_beyond_the_working_range_up_to_the_ends_of_the_allowed_one():
    for direction in (-1.0, 1.0):
        forces = [direction * steady_force(Damper(), direction * 0.3, i) for i in (0.20, 0.29, 0.70, 1.0, 1.6)]
        assert (np.diff(forces) > 50.0).all()
        below, above = (direction * steady_force(Damper(), direction * 0.3, i) for i in (0.0, 3.0))
        assert (below, above) == (forces[0], forces[-1])


@pytest.mark.parametrize("current", [0.29, 0.7])
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


TICK_S = 1e-3


@pytest.fixture
def signals():
    time = np.arange(0, 0.6, TICK_S)
    stroke = 0.01 * np.sin(2 * np.pi * 5 * time) ** 3
    return stroke, spline_speed(time, stroke), 0.5 + 0.2 * np.sin(40 * time)


def test_chunks_equal_the_batch_exactly(signals):
    stroke, speed, current = signals
    batch = simulate(HydraulicDamper(Damper()), TICK_S, stroke, current, speed).force_N
    stepper = DamperStepper(HydraulicDamper(Damper()), TICK_S)
    chunked = [stepper.settle(stroke[0], speed[0], current[0])]
    for part in (slice(1, 2), slice(2, 3), slice(3, 250), slice(250, 600)):
        chunked.extend(stepper.advance(stroke[part], speed[part], current[part]))
    assert np.array_equal(batch, chunked)


def test_reset_brings_it_back_to_new(signals):
    stroke, speed, current = signals
    stepper = DamperStepper(HydraulicDamper(Damper()), TICK_S)
    first = stepper.advance(stroke, speed, current)
    assert not np.array_equal(stepper.advance(stroke, speed, current), first)
    stepper.settle()
    assert np.array_equal(stepper.advance(stroke, speed, current), first)


def test_the_oil_warms_by_the_work_put_in():
    damper = Damper()
    time = np.arange(0, 5, TICK_S)
    stroke = 0.018 * np.clip(time, 0, 1) ** 2 * np.sin(2 * np.pi * 4 * time)
    run = simulate(HydraulicDamper(damper), TICK_S, stroke, np.full_like(time, 0.6))
    work = np.sum((run.force_N[1:] + run.force_N[:-1]) / 2 * np.diff(stroke))
    oil = run.state("oil_degC")
    lost = damper.heat.loss_W_K * np.sum(oil - damper.heat.ambient_degC) * TICK_S
    assert work > 500.0
    # the rest: bushing damping (not oil) and what is stored in springs
    assert (oil[-1] - oil[0]) * damper.heat.capacity_J_K + lost == pytest.approx(work, rel=0.03)


@pytest.mark.parametrize(
    ("stroke", "current", "says"),
    [
        ([0.0], [0.5], "equal lengths"),
        ([0.0, 0.0, 0.0], [0.5, 0.5], "equal lengths"),
        ([0.0, np.nan], [0.5, 0.5], "not finite"),
        ([0.0, 0.01], [0.5, np.inf], "not finite"),
        ([0.0, 0.07], [0.5, 0.5], "0.07 m; the damper's ends are at ±0.06 m"),
    ],
)
def test_bad_input_is_refused(stroke, current, says):
    with pytest.raises(RigError, match=says):
        simulate(HydraulicDamper(Damper()), TICK_S, np.array(stroke), np.array(current))
