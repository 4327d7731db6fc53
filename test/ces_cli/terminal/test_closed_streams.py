"""What reaches the terminal: tables within its width, characters that it has, closed streams and full disks."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from ces_cli.main import main
from ces_cli.terminal import terminal
from ces_cli.terminal.outputs import print_document
from ces_cli.terminal.results import describe_range
from ces_cli.terminal.terminal import lay_out, print_table, run
from ces_report.table import text_table

NUMBERS = ("-123456.7", "12.34-56.78", "1234567", "diverged", "100.0", "-98765.4", "0.001")
HEADINGS = ("RMS N", "95 %", "samples", "J %", "out %", "from", "to")
NAME = "rear_damper_2026-11-22_long_name_of_a_recording_17"


def printed(capsys, monkeypatch, table, width):
    monkeypatch.setattr(terminal.out, "width", width)
    print_table(table)
    return capsys.readouterr().out


def wide_table():
    return lay_out(text_table(("recording", *HEADINGS), [(name, *NUMBERS) for name in (NAME, f"{NAME}8")], "costs"))


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
def test_every_number_is_shown_whole_within_the_width(capsys, monkeypatch, width):
    text = printed(capsys, monkeypatch, wide_table(), width)
    assert max(map(len, text.splitlines())) <= width
    assert all(text.count(number) >= 2 for number in NUMBERS)
    assert "…" not in text and text.count("costs") == 1
    parts = sum("──" in line for line in text.splitlines())
    assert (parts > 1) == (width <= 80)


def test_a_table_that_fits_is_one(capsys, monkeypatch):
    small = lay_out(text_table(("a", "b"), [("x", "1")], "small"))
    assert len(printed(capsys, monkeypatch, small, 20).split("a  b")) == 2


READ_ONLY_INSTALLATION = """
import os
from pathlib import Path
from ces_cli import main
main.PACKAGE = Path("/proc/nowhere")
main.require_folder_for_compiled_code()
print(os.environ["NUMBA_CACHE_DIR"], Path(os.environ["NUMBA_CACHE_DIR"]).is_dir())
"""


class AsciiOutput(io.TextIOWrapper):
    """Standard output of a terminal that has ASCII only."""

    def __init__(self) -> None:
        self.bytes = io.BytesIO()
        super().__init__(self.bytes, encoding="ascii")

    def text(self) -> str:
        self.flush()
        return self.bytes.getvalue().decode("ascii")


def replace_output(monkeypatch: pytest.MonkeyPatch) -> AsciiOutput:
    output = AsciiOutput()
    monkeypatch.setattr(sys, "stdout", output)
    return output


def test_characters_that_a_terminal_does_not_have_are_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    def program(argv: Sequence[str] | None) -> int:
        print("pr\N{LATIN SMALL LETTER U WITH DIAERESIS}fstand\N{SUPERSCRIPT TWO}")
        return 0

    ascii_output = replace_output(monkeypatch)
    assert run("info", program) == 0
    assert ascii_output.text() == "pr\\xfcfstand\\xb2\n"


def test_json_stays_json_in_ascii(monkeypatch: pytest.MonkeyPatch) -> None:
    ascii_output = replace_output(monkeypatch)
    name = "pr\N{LATIN SMALL LETTER U WITH DIAERESIS}fstand"
    print_document("rig", {"bag": name})
    assert json.loads(ascii_output.text())["bag"] == name


def test_a_full_disk_is_one_line(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "stdout", Path("/dev/full").open("w", encoding="utf-8"))  # noqa: SIM115 - cannot be closed
    assert main(["schema", "--list"]) == 2
    err = capfd.readouterr().err
    assert "No space left on device" in err and err.count("\n") == 1


def test_a_read_only_installation_without_a_home_keeps_compiled_code_for_one_run(tmp_path: Path) -> None:
    environment = {"PATH": os.environ["PATH"], "HOME": "/proc/nowhere", "TMPDIR": str(tmp_path)}
    root = Path(__file__).resolve().parents[3]
    code = [sys.executable, "-c", READ_ONLY_INSTALLATION]
    done = subprocess.run(code, cwd=root, env=environment, capture_output=True, text=True, check=True)
    folder, exists = done.stdout.split()
    assert Path(folder).parent == tmp_path and exists == "True"
    assert "name a folder in NUMBA_CACHE_DIR" in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())  # gone with the run


def test_a_range_of_two_numbers_that_read_the_same_is_one_number() -> None:
    assert (describe_range(231.8, 232.3), describe_range(88.0, 232.3)) == ("232", "88 to 232")
