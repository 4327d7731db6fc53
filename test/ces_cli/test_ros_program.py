"""`ros2 run ces_observer NAME` starts a program of `ces`, or the node of the same name."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import pytest

from ces_cli.main import NODES, PROGRAMS, is_node, run_for_ros
from ces_cli.main import main as ces


@pytest.mark.parametrize(
    ("name", "words", "expected"),
    [
        ("identify", ["--ros-args"], True),
        ("identify", ["--ros-args", "--params-file", "identify.yaml"], True),
        ("identify", ["bags/noise"], False),
        ("identify", [], False),
        ("rig", [], True),
        ("rig", ["--ros-args"], True),
        ("rig", ["sweep.yaml", "--out", "sweep"], False),
        ("replay", ["--ros-args"], False),
        ("info", [], False),
    ],
)
def test_nodes_are_known_by_their_arguments(name: str, words: list[str], expected: bool) -> None:
    assert is_node(name, words) == expected


def test_every_node_is_a_program_and_has_a_module() -> None:
    assert set(NODES) <= set(PROGRAMS)
    assert all(find_spec(module) for module in NODES.values())


def test_the_file_name_selects_the_program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["/opt/lib/ces_observer/identify", "--show-candidates"])
    assert run_for_ros() == 0
    assert "products:" in capsys.readouterr().out


def test_a_vehicle_is_told_in_one_line_what_the_desk_has_more(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("ces_cli.main.find_spec", lambda name: None if name in ("numba", "rich") else find_spec(name))
    for words in (["info"], ["identify", "--ros-args"], ["rig"]):
        monkeypatch.setattr(sys, "argv", words)
        assert run_for_ros() == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(
            f"ces {words[0]}: error: not installed: numba, rich, as on a vehicle; run 'rosdep install"
        )


def test_ces_is_no_node(capsys: pytest.CaptureFixture[str]) -> None:
    assert ces(["identify", "--ros-args"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        "ces identify: error: --ros-args is only for nodes; with ROS 2 sourced, run 'ros2 run ces_observer identify'"
    )
