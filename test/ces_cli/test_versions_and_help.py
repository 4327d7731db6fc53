"""What `ces` says of itself: the versions in use, the help of a program, and the program that was probably meant."""

from __future__ import annotations

import json
import platform
from importlib import metadata

import pytest

from ces_cli.main import PROGRAMS, main
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
