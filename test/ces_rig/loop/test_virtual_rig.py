"""The virtual rig of the loop: the same forces as `ces rig`, and clear words for a plan that it cannot follow."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from iterate_examples import LIMITS, make_plan, sine_commands, small_rig

from ces_observer.errors import CesError
from ces_rig.experiments.commands import RigCommands
from ces_rig.experiments.virtual import parse_experiment, run
from ces_rig.loop.rigs import VirtualRig, open_rig
from ces_rig.sensors import GRID_S


def test_it_records_what_ces_rig_records(tmp_path: Path) -> None:
    experiment = parse_experiment(
        {
            "duration_s": 2.0,
            "stroke": {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 2.0},
            "current": {"kind": "constant", "current_A": 0.5},
        },
        "sine",
    )
    time = np.arange(2001) * 1e-3
    commands = RigCommands("experiment", experiment.stroke.samples(time, np.random.default_rng(0)), np.full(2001, 0.5))
    mine, theirs = VirtualRig().run(commands, tmp_path).channels, run(experiment).channels
    for name in ("position", "current", "force"):
        assert np.array_equal(mine[name].stamps_ns, theirs[name].stamps_ns)
    assert np.abs(mine["force"].values - theirs["force"].values).max() <= 2.0  # two quanta of the load cell
    assert pytest.approx(0.5e-3) == GRID_S


def test_it_repeats_exactly_and_its_noise_depends_on_the_seed(tmp_path: Path) -> None:
    rig, commands = small_rig(), sine_commands(duration_s=1.0)
    first, again = (rig.run(commands, tmp_path).channel("force").values for _ in range(2))
    other = rig.run(commands.repeat("sine", 2, 0.0), tmp_path).channel("force").values
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("limits", "rig", "part"),
    [
        ({"high_A": 9.0}, {"kind": "virtual"}, "set limits: low_A and high_A"),
        ({"stroke_m": 0.4}, {"kind": "virtual"}, "lower limits: stroke_m"),
        ({}, {"kind": "virtual", "damper": "missing.yaml"}, "missing.yaml: cannot be read"),
        ({}, {"kind": "virtual", "dampr": "x"}, "unknown key 'dampr'"),
        ({}, {"kind": "robot"}, "expected one of virtual, folder, ros"),
        ({}, {"kind": "folder", "mapping": "missing.yaml"}, "missing.yaml: cannot be read"),
    ],
)
def test_a_rig_that_cannot_do_it_is_refused_in_one_line(tmp_path: Path, limits: dict, rig: dict, part: str) -> None:
    plan = make_plan(tmp_path, limits={**LIMITS, **limits}, rig=rig)
    with pytest.raises(CesError, match=part) as error:
        open_rig(plan)
    assert "\n" not in str(error.value)


@pytest.mark.skipif(find_spec("rclpy") is not None, reason="ROS 2 is sourced")
def test_a_rig_behind_topics_needs_ros(tmp_path: Path) -> None:
    with pytest.raises(CesError, match="rclpy is missing; source ROS 2 first"):
        open_rig(make_plan(tmp_path, rig={"kind": "ros"}))
