"""Batch and chunks give the same force; bad input is refused in a line."""

import numpy as np
import pytest

from ces_rig.dampers.hydraulic.parameters import Damper, Hydraulic
from ces_rig.dampers.stepper import DamperStepper, simulate, spline_speed
from ces_rig.errors import RigError

GRID = 1e-3


@pytest.fixture
def signals():
    time = np.arange(0, 0.6, GRID)
    stroke = 0.01 * np.sin(2 * np.pi * 5 * time) ** 3
    return stroke, spline_speed(time, stroke), 0.5 + 0.2 * np.sin(40 * time)


def test_chunks_equal_the_batch_exactly(signals):
    stroke, speed, current = signals
    batch = simulate(Hydraulic(Damper()), GRID, stroke, current, speed).force_N
    stepper = DamperStepper(Hydraulic(Damper()), GRID)
    chunked = [stepper.settle(stroke[0], speed[0], current[0])]
    for part in (slice(1, 2), slice(2, 3), slice(3, 250), slice(250, 600)):
        chunked.extend(stepper.advance(stroke[part], speed[part], current[part]))
    assert np.array_equal(batch, chunked)


def test_reset_brings_it_back_to_new(signals):
    stroke, speed, current = signals
    stepper = DamperStepper(Hydraulic(Damper()), GRID)
    first = stepper.advance(stroke, speed, current)
    assert not np.array_equal(stepper.advance(stroke, speed, current), first)
    stepper.settle()
    assert np.array_equal(stepper.advance(stroke, speed, current), first)


def test_the_oil_warms_by_the_work_put_in():
    damper = Damper()
    time = np.arange(0, 5, GRID)
    stroke = 0.018 * np.clip(time, 0, 1) ** 2 * np.sin(2 * np.pi * 4 * time)
    run = simulate(Hydraulic(damper), GRID, stroke, np.full_like(time, 0.6))
    work = np.sum((run.force_N[1:] + run.force_N[:-1]) / 2 * np.diff(stroke))
    oil = run.state("oil_degC")
    lost = damper.heat.loss_W_K * np.sum(oil - damper.heat.ambient_degC) * GRID
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
        simulate(Hydraulic(Damper()), GRID, np.array(stroke), np.array(current))
