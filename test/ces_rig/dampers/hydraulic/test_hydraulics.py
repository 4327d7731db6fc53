"""The kernel: it conserves oil, converges, stays above the vapour floor, and agrees with its slow twin."""

import numpy as np
import pytest
from hydraulics_twin import Twin

from ces_rig.dampers.hydraulic import kernel as hy
from ces_rig.dampers.hydraulic.kernel import STEP_S
from ces_rig.dampers.hydraulic.parameters import Damper, Hydraulic, coefficients, parse_damper
from ces_rig.dampers.stepper import simulate

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
    runs = [simulate(Hydraulic(Damper()), GRID, stroke, current, step_s=h) for h in (STEP_S, STEP_S / 2)]
    astray = [np.ptp(mass(Damper(), run)) for run in runs]
    # about 0.3 kg/s flow to and fro; what goes astray is the integrator's error alone, so it falls with the step
    assert astray[0] < 2e-6
    assert astray[1] < 0.4 * astray[0]


def test_gas_takes_up_the_rod():
    damper = Damper()
    at_rest = np.zeros(hy.STATE_SIZE)
    hy.settle(coefficients(damper), at_rest, 0.04, 0.0, 0.3)
    gas = damper.reservoir
    volume = gas.gas_m3 * (gas.pressure_Pa / at_rest[hy.P_GAS]) ** (1 / gas.exponent)
    # a little less than the rod's volume: the oil gives too
    assert 0.95 * 0.04 * damper.rod_area_m2 < gas.gas_m3 - volume < 0.04 * damper.rod_area_m2


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.018, 4.0), (0.006, 12.0), (0.012, 16.0)])
def test_halving_the_step_changes_little(amplitude, frequency):
    _, stroke, current = drive(1.0, amplitude, frequency)
    coarse = simulate(Hydraulic(Damper()), GRID, stroke, current).force_N
    fine = simulate(Hydraulic(Damper()), GRID, stroke, current, step_s=STEP_S / 2).force_N
    assert relative_rms(coarse, fine) < 0.002


def test_order_of_convergence():
    _, stroke, current = drive(0.5)
    reference = simulate(Hydraulic(Damper()), GRID, stroke, current, step_s=GRID / 160).force_N
    coarse, fine = (
        relative_rms(simulate(Hydraulic(Damper()), GRID, stroke, current, step_s=GRID / n).force_N, reference)
        for n in (10, 20)
    )
    assert 3.5 < coarse / fine < 4.5  # second order


def test_agrees_with_the_slow_twin():
    damper = Damper()
    time, stroke, current = drive(0.5, 0.012, 6.0)
    run = simulate(Hydraulic(damper), GRID, stroke, current)
    twin = Twin(damper)
    fine = np.arange(0, time[-1] + 1e-9, GRID / 50)
    pilot = twin.pilot_pressure(fine, np.interp(fine, time, current))
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(time, stroke)
    force = twin.force(
        run.states[0, : hy.UNKNOWNS], time[::20], spline, spline.derivative(), lambda t: np.interp(t, fine, pilot)
    )
    assert np.std(force) > 500.0
    assert relative_rms(run.force_N[::20], force) < 0.002


def test_pressures_stop_at_the_vapour_floor():
    damper = parse_damper({"reservoir": {"pressure_Pa": 1.1e5}}, "thin gas")
    time = np.arange(0, 1.0, GRID)
    stroke = 0.035 * np.clip(time / 0.2, 0, 1) ** 3 * np.sin(2 * np.pi * 10 * time)
    run = simulate(Hydraulic(damper), GRID, stroke, np.full_like(time, 0.6))
    lowest = run.state("p_compression_Pa").min()
    assert hy.LOWEST_PA < lowest < 1.3 * damper.oil.vapour_pressure_Pa
    assert np.isfinite(run.force_N).all()
    assert np.ptp(mass(damper, run)) < 1e-3 * mass(damper, run)[0]
    full = simulate(Hydraulic(Damper()), GRID, stroke, np.full_like(time, 0.6))
    assert full.state("p_compression_Pa").min() > 3e5  # the gas pressure prevents it


def test_slope_of_the_orifice_is_its_derivative():
    c = coefficients(Damper())
    for drop in (-2e6, -3e3, 0.0, 50.0, 4e3, 1e6):
        h = 1e-3 * max(abs(drop), 100.0)
        difference = (hy.orifice(c, 1e-6, drop + h)[0] - hy.orifice(c, 1e-6, drop - h)[0]) / (2 * h)
        assert hy.orifice(c, 1e-6, drop)[1] == pytest.approx(difference, rel=1e-4)


def test_aeration_softens_the_oil_at_low_pressure():
    c = coefficients(Damper())

    def bulk(p):
        volume, slope = hy.specific_volume(c, p)
        return volume / slope

    assert bulk(2e5) < 0.1 * bulk(1e7)
    assert bulk(1e7) < Damper().oil.bulk_modulus_Pa
    assert bulk(1e7) > 0.9 * Damper().oil.bulk_modulus_Pa


def test_magnetic_loop_has_the_width_of_its_parameter():
    c = coefficients(Damper())
    state = np.zeros(hy.STATE_SIZE)
    hy.settle(c, state, 0.0, 0.0, 0.29)
    seen = {}
    triangle = np.concatenate([np.linspace(0.29, 0.70, 20_000), np.linspace(0.70, 0.29, 20_000)])
    for n, current in enumerate(triangle):
        hy.current_path(c, state, current, 1e-3)
        seen[n] = state[hy.PLAY : hy.PLAY + hy.PLAYS].mean()
    width = seen[29_999] - seen[10_000]  # near the middle, falling less rising
    assert width == pytest.approx(2 * Damper().ces_valve.hysteresis_A, rel=0.02)
