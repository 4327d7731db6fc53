"""The program `ces` and what ROS 2 starts: versions, help, misspelt programs, nodes, and a vehicle without the desk."""

from __future__ import annotations

import json
import platform
import sys
from importlib import metadata
from importlib.util import find_spec

import pytest

from ces_cli.main import NODES, PROGRAMS, is_node, main, run_for_ros
from ces_cli.main import main as ces
from ces_observer import __version__


def test_the_versions_are_those_of_the_installed_packages(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"ces_observer {__version__}"
    assert f"python        {platform.python_version()}" in lines[1]
    assert main(["--version", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "ces-version/1" and document["ces_observer"] == __version__
    assert document["packages"]["numpy"] == metadata.version("numpy")
    assert "pytest" not in document["packages"]
    assert all(f"{name:<14}{version or 'absent'}" in lines for name, version in document["packages"].items())


def test_help_names_a_part_of_a_program(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["help", "blind", "make"])
    assert stop.value.code == 0 and capsys.readouterr().out.startswith("usage: ces blind make")


def test_the_help_says_that_an_fmu_runs_native_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    assert "native code" in " ".join(capsys.readouterr().out.split())


def test_help_of_a_program_is_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["help"]) == 0
    assert capsys.readouterr().out.startswith("usage: ces PROGRAM")
    with pytest.raises(SystemExit) as stop:
        main(["help", "export-data"])
    assert stop.value.code == 0
    assert capsys.readouterr().out.startswith("usage: ces export-data")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("identity", "identify"), ("diagnos", "diagnose"), ("export_data", "export-data"), ("vaildate", "validate")],
)
def test_a_misspelt_program_is_recognised(typed: str, meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([typed], ["help", typed]):
        assert main(words) == 2
        assert capsys.readouterr().err == f"ces: error: unknown program '{typed}'; did you mean '{meant}'?\n"


def test_a_wrong_word_lists_the_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["xyzzy"]) == 2
    error = capsys.readouterr().err
    assert all(name in error for name in PROGRAMS)
    assert main(["--version", "long"]) == 2
    assert capsys.readouterr().err == "ces --version: error: found 'long'; expected nothing more, or --json\n"


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
