"""Tables on a narrow terminal: no number is cut, and a table that is too wide is printed in parts."""

from __future__ import annotations

import pytest

from ces_cli.terminal import terminal
from ces_cli.terminal.terminal import lay_out, print_table
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
