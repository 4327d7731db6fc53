"""CAN logs as text, in the form that python-can reads.

Its readers skip the negative times of a trigger, take relative times for absolute ones, and know candump's files but
not its console output.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from io import TextIOBase
from itertools import pairwise
from pathlib import Path

from ces_observer.errors import RecordingError

SAMPLE, RISING = 200, 0.9  # timed lines, of which more rise if the times are not relative
TIMED = re.compile(r"\s*(-?\d+\.\d+)(\s.*)", re.DOTALL)
RELATIVE = re.compile(r"\s*base\s+\w+\s+timestamps\s+relative", re.IGNORECASE)
CONSOLE = re.compile(
    r"\s*(?:\((?P<time>[^)]+)\)\s+)?(?P<bus>\S+)\s+(?:[TR]X\s+\S+\s+\S+\s+)?(?P<id>[0-9A-Fa-f]+)\s+\[(?P<length>\d+)\]"
    r"\s*(?P<data>(?:[0-9A-Fa-f]{2}\s?)*)"
)


class TextLines(TextIOBase):
    """The lines of a text log with times that python-can reads: `shift_s` is added to each of them."""

    def __init__(self, path: Path) -> None:
        self._asc, self.shift_s = path.suffix.lower() == ".asc", 0.0
        self._lines = self._asc_lines(path) if self._asc else _candump_lines(path)

    def __next__(self) -> str:  # type: ignore[override]
        return next(self._lines)

    def _asc_lines(self, path: Path) -> Iterator[str]:
        with path.open(encoding="utf-8", errors="replace") as file:
            relative, times = False, list[float]()
            for line in file:
                relative = relative or RELATIVE.match(line) is not None
                if match := TIMED.match(line):
                    times.append(float(match[1]))
                if len(times) == SAMPLE:
                    break
            rising = sum(after > before for before, after in pairwise(times))
            relative = relative and rising < RISING * (len(times) - 1)  # else the header is wrong
            self.shift_s = float(-min([0.0, *times]) // 1 + 1) if min(times, default=0.0) < 0.0 else 0.0
            file.seek(0)
            yield from _with_times(file, relative, self.shift_s)


def _with_times(lines: Iterator[str], relative: bool, shift_s: float) -> Iterator[str]:
    """Yield the lines of an ASC log; relative times count from the event before."""
    now_s, begun = 0.0, False
    for line in lines:
        match = TIMED.match(line)
        if match is None:
            yield line
            continue
        if not begun:  # the reader loses the line at which its search for this one ends
            yield "no internal events logged\n"
            begun = True
        now_s = float(match[1]) + now_s * relative
        yield f"{now_s + shift_s:.9f}{match[2]}"


def _candump_lines(path: Path) -> Iterator[str]:
    """Yield the lines of candump's log, made of its console output if the file holds that."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            match = CONSOLE.match(line)
            if match is None:
                yield line
                continue
            if match["time"] is None:
                what = f"{path}:{number}: candump's console output, which has no times"
                raise RecordingError(f"{what}; record the bus again with candump -l, or with candump -ta")
            data = "".join(match["data"].split())
            mark = "#" if int(match["length"]) <= 8 else "##0"
            yield f"({_seconds(match['time'], path, number):.9f}) {match['bus']} {match['id']}{mark}{data}\n"


def _seconds(text: str, path: Path, number: int) -> float:
    """Return the time that candump prints with -ta, -tz (a number) or -tA (a date)."""
    try:
        return float(text)
    except ValueError:
        try:
            return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
        except ValueError:
            expected = "expected seconds, or a date such as 2026-05-14 10:00:00.250"
            raise RecordingError(f"{path}:{number}: the time is {text!r}; {expected}") from None
