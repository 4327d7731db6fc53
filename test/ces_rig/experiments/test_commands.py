"""The file of an experiment: what is written is read again; what is wrong is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from iterate_examples import sine_commands

from ces_rig.errors import RigError
from ces_rig.experiments.commands import HEADER, RigCommands, read_commands, write_commands


def test_a_written_experiment_is_read_again(tmp_path: Path) -> None:
    commands = sine_commands()
    write_commands(tmp_path / "sine.csv", commands)
    again = read_commands(tmp_path / "sine.csv")
    assert np.abs(again.stroke_m - commands.stroke_m).max() < 1e-8
    assert np.abs(again.current_A - commands.current_A).max() < 1e-5
    assert again.name == "sine"
    assert again.duration_s == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("a,b,c\n0,0,0\n0.001,0,0\n", "first line"),
        (f"{HEADER}\n0,0,0\n0.002,0,0\n", "every 0.001 s"),
        (f"{HEADER}\n0,0,0\n0.001,x,0\n", "three numbers"),
        (f"{HEADER}\n0,0,0\n0.001,nan,0\n", "not a finite number"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, text: str, part: str) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(RigError, match=part):
        read_commands(path)


def test_the_stroke_between_grid_points_is_a_cubic_and_the_current_is_held() -> None:
    time = np.arange(101) * 1e-3
    commands = RigCommands("c", 0.01 * time**3, np.where(time < 0.05, 0.3, 0.7))
    stroke, current = commands.at(0.5e-3)
    fine = np.arange(201) * 0.5e-3
    assert np.abs(stroke - 0.01 * fine**3).max() < 1e-12
    assert set(current) == {0.3, 0.7}
    assert current[99] == 0.3
    assert current[100] == 0.7
