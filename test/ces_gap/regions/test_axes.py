from dataclasses import replace

import numpy as np
import pytest
from gap_traces import drive, trace_of

from ces_gap.regions.axes import (
    CURRENT,
    DIRECTION,
    ELAPSED,
    HEAT,
    REVERSAL,
    SPEED,
    STROKE,
    axis_edges,
    axis_values,
    region_indices,
)
from ces_gap.trace import Trace, TraceInputs

T = np.arange(5000) / 500.0


def sine(frequency_Hz: float = 2.0) -> Trace:
    return trace_of(T, 0.02 * np.sin(2 * np.pi * frequency_Hz * T), np.full_like(T, 0.8))


def test_time_since_reversal_is_a_saw_tooth_of_half_periods():
    trace = sine()
    since = axis_values(trace)[REVERSAL]
    expected = np.mod(trace.time_s - 0.125, 0.25)
    assert np.median(np.abs(since - expected)[trace.usable]) <= trace.step_s
    assert since[trace.usable].max() <= 0.25 + trace.step_s


def test_direction_is_that_of_the_speed_and_positive_in_compression():
    trace = sine()
    direction = axis_values(trace)[DIRECTION]
    moving = trace.usable & (np.abs(trace.inputs.speed) > 0.02)
    assert (direction == np.sign(trace.inputs.speed))[moving].all()


def test_noise_near_standstill_is_no_reversal():
    rng = np.random.default_rng(0)
    trace = sine(0.5)
    speed = trace.inputs.speed + 0.0003 * rng.normal(size=len(trace))
    shaken = replace(trace, inputs=TraceInputs(trace.inputs.position, speed, trace.inputs.current))
    turns = np.diff(axis_values(shaken)[DIRECTION])[trace.usable[1:]] != 0.0
    crossings = np.diff(np.sign(speed))[trace.usable[1:]] != 0.0
    assert turns.sum() == 10
    assert crossings.sum() > 10


def test_a_damper_at_rest_has_no_reversal():
    trace = sine()
    still = replace(trace, inputs=TraceInputs(trace.inputs.position, np.zeros(len(trace)), trace.inputs.current))
    assert axis_values(still)[REVERSAL] == pytest.approx(trace.time_s)


def test_heat_is_the_work_of_the_force():
    trace = sine()
    heat = axis_values(trace)[HEAT]
    amplitude = 2 * np.pi * 2.0 * 0.02
    assert heat[-1] == pytest.approx(0.5 * 1500.0 * 1.8 * amplitude**2 * 10.0, rel=0.02)
    assert (np.diff(heat) >= 0.0).all()


@pytest.mark.parametrize("axis", [STROKE, SPEED, REVERSAL, ELAPSED, HEAT])
def test_edges_hold_all_values_in_a_handful_of_regions_none_empty(axis):
    values = np.concatenate([axis_values(t)[axis][t.usable] for t in (drive(1), drive(2))])
    edges = axis_edges(axis, values)
    assert edges[0] <= values.min() and values.max() <= edges[-1]
    assert 4 <= len(edges) - 1 <= 13
    assert np.bincount(region_indices(edges, values)).min() >= 0.003 * len(values)


def test_every_level_of_a_stepped_current_is_a_region():
    values = np.random.default_rng(0).choice([0.0, 0.4, 0.8, 1.6], 5000)
    assert axis_edges(CURRENT, values) == pytest.approx([0.0, 0.2, 0.6, 1.2, 1.6])
