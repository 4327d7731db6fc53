"""The kernels of the flat-described dampers: they converge and remember."""

import numpy as np
import pytest

from ces_rig.dampers.bouc_wen.kernel import BoucWen
from ces_rig.dampers.lookup.kernel import Lookup
from ces_rig.dampers.stepper import KINDS as ALL
from ces_rig.dampers.stepper import simulate
from ces_rig.errors import RigError

GRID = 0.5e-3


def drive(high_A, seconds=1.0, amplitude=0.02, frequency=3.0):
    time = np.arange(0, seconds, GRID)
    rise = np.clip(time / 0.1, 0, 1)
    stroke = amplitude * rise**2 * (3 - 2 * rise) * np.sin(2 * np.pi * frequency * time)
    return time, stroke, high_A * (0.5 + 0.4 * np.sin(2 * np.pi * 4.3 * time))


def relative_rms(a, b):
    return np.sqrt(np.mean((a - b) ** 2)) / np.std(b)


HIGH_A = {BoucWen: 1.6, Lookup: 1.6}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "high"), list(HIGH_A.items()))
def test_half_the_step_gives_the_same_force(kind, high):
    _, stroke, current = drive(high)
    force = simulate(kind(), GRID, stroke, current).tared_N
    half = 0.5 * ALL[kind.kind].kernel.STEP_S
    assert 0.0 < relative_rms(force, simulate(kind(), GRID, stroke, current, step_s=half).tared_N) < 0.01


@pytest.mark.parametrize(("kind", "high"), list(HIGH_A.items()))
def test_more_field_damps_more_and_at_rest_nothing_but_gas_pushes(kind, high):
    _, stroke, _ = drive(high)
    energy = [
        float(np.dot(simulate(kind(), GRID, stroke, np.full_like(stroke, share * high)).tared_N, np.gradient(stroke)))
        for share in (0.1, 0.5, 1.0)
    ]
    assert 0 < energy[0] < 0.8 * energy[1] < 0.8 * energy[2]
    still = np.full(2000, 0.01)
    force = simulate(kind(), GRID, still, np.full(2000, high)).tared_N
    assert force[-1] > 0 and force[-1] == pytest.approx(force[1000], abs=1.0)


def test_the_mr_dampers_coil_lags_and_can_be_left_out():
    _, stroke, current = drive(1.6)
    coil = simulate(BoucWen(coil_s=5e-3), GRID, stroke, current).coil_A
    assert relative_rms(coil, current) > 0.05
    bare = simulate(BoucWen(coil_s=5e-3).without_coil(), GRID, stroke, current).coil_A
    assert np.abs(bare - current).max() < 2e-3  # half a step of the integrator


@pytest.mark.parametrize("kind", HIGH_A)
def test_a_gas_too_small_is_refused(kind):
    with pytest.raises(RigError, match="cannot take up the rod's volume"):
        kind(gas_m3=1e-6)
