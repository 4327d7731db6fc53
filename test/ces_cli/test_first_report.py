"""The tutorial docs/first-report.md, its commands run literally on a CSV file with the columns that it shows."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from small_recordings import write_small_csv

from ces_cli.main import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "first-report.md"
INSTALLING = ("python3 -m venv", ".venv/bin/pip", ". .venv")


def commands(text: str) -> list[tuple[str, list[str]]]:
    """Return the commands in the page's console blocks, each with the lines printed below it."""
    found: list[tuple[str, list[str]]] = []
    for block in re.findall(r"```console\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            else:
                found[-1][1].append(line)
    return [(command, printed) for command, printed in found if not command.startswith(INSTALLING)]


def test_the_commands_of_the_tutorial_give_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    write_small_csv(Path("my_log.csv"), seed=1, seconds=8.0, in_mm=True)
    write_small_csv(Path("my_other_log.csv"), seed=2, seconds=6.0, in_mm=True)
    assert Path("my_log.csv").read_text().splitlines()[0] in page
    written = []
    for command, printed in commands(page):
        program, *words = shlex.split(command)
        assert program == "ces"
        monkeypatch.setattr("sys.argv", [program, *words])
        assert main(words) == 0, command
        out = capsys.readouterr().out
        assert all(line.replace("15000", "4000") in out for line in printed), out
        written.append(words[0])
    assert written == ["import", "identify", "import", "validate"]
    assert json.loads(Path("model.json").read_text())["structure"] == "polynomial_narx"
    for report in ("report.html", "validation.html"):
        assert "<html" in Path(report).read_text(encoding="utf-8")


def test_every_command_of_the_page_is_parsed(capsys: pytest.CaptureFixture[str]) -> None:
    page = PAGE.read_text(encoding="utf-8")
    for block in re.findall(r"```\n(ces .*?)```", page, re.DOTALL):
        for line in block.splitlines():
            words = shlex.split(line.partition(" > ")[0])[1:]
            with pytest.raises(SystemExit) as stop:
                main([*words, "--help"])
            assert stop.value.code == 0
