"""Set points and the watch of a run, without ROS."""

from __future__ import annotations

import numpy as np
import pytest
from iterate_examples import sine_commands

from ces_rig.errors import RigError
from ces_rig.loop.rigs import RosRigSettings, RunWatch, smooth_move

SETTINGS = RosRigSettings(rate_hz=100.0)


def test_a_run_has_the_strokes_of_the_experiment() -> None:
    commands = sine_commands()
    stroke_m, current_A = commands.at(0.01)
    assert stroke_m == pytest.approx(commands.stroke_m[::10], abs=1e-12)
    assert len(current_A) == 301


def test_a_move_begins_and_ends_at_rest() -> None:
    stroke_m = smooth_move(-0.01, 0.02, 1.0, 100.0)
    steps = np.diff(stroke_m)
    assert (stroke_m[0], stroke_m[-1]) == pytest.approx((-0.01, 0.02))
    assert steps.min() >= 0.0
    assert max(steps[0], steps[-1]) < 1e-6


def test_a_rig_that_lags_a_little_passes() -> None:
    watch, late = RunWatch(SETTINGS, "run", 0.0), 5
    strokes, _ = sine_commands().at(0.01)
    for k in range(late, len(strokes)):
        watch.check(0.01 * k, float(strokes[k]), (0.01 * k, float(strokes[k - late])))


def test_a_rig_that_does_not_follow_is_stopped() -> None:
    watch = RunWatch(SETTINGS, "run", 0.0)
    with pytest.raises(RigError, match=r"run: the stroke is 11\.\d mm from its set points"):
        for k in range(100):
            watch.check(0.01 * k, 0.001 * k, (0.01 * k, 0.0))


def test_a_silent_rig_is_stopped() -> None:
    watch = RunWatch(SETTINGS, "run", 10.0)
    watch.check(10.2, 0.0, None)
    with pytest.raises(RigError, match=r"no position for 0.60 s"):
        watch.check(10.6, 0.0, None)
