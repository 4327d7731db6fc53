"""Times as text: dates with a time of day, or a time of day alone, into nanoseconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from ces_identify.recordings.recording import Stamps

ISO = re.compile(r"(\d{4}-\d\d-\d\d)[T _](\d\d:\d\d(?::\d\d)?)([.,]\d{1,9})?\s*(Z|[+-]\d\d:?\d\d)?$")
GERMAN = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[ _T](\d{1,2}):(\d\d):(\d\d)([.,]\d{1,9})?$")
CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d)([.,]\d{1,9})?$")
DAY_NS = 86_400_000_000_000
SLASHED = re.compile(r"\d{1,4}/\d{1,2}/\d{1,4}[ T]")


def is_date(cell: str) -> bool:
    """Return whether a cell is a date or a time of day in some form."""
    text = cell.strip()
    return any(pattern.match(text) for pattern in (ISO, GERMAN, CLOCK, SLASHED))


def parse_dates(cells: Sequence[str], pattern: str) -> Stamps:
    """Return the times of cells in nanoseconds since 1970, UTC if they state no zone; times of day count from midnight.

    Without a `pattern` (as in `datetime.strptime`) ISO 8601, 31.12.2024 23:59:59.5 and 23:59:59.5 are read. Raises
    ValueError for the first cell that is not a time, with its row as second argument.
    """
    read = _reader(cells[0].strip() if cells else "", pattern)
    stamps = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        try:
            stamps[row] = read(cell.strip())
        except (ValueError, AttributeError):
            raise ValueError(cell, row) from None
    return _unwrap_midnight(stamps) if read is _read_clock else stamps


def _reader(first: str, pattern: str) -> Callable[[str], int]:
    if pattern:
        return lambda text: _to_ns(datetime.strptime(text, pattern))
    if CLOCK.match(first):
        return _read_clock
    return _read_german if GERMAN.match(first) else _read_iso


def _read_iso(text: str) -> int:
    day, clock, fraction, zone = _match(ISO, text)
    return _to_ns(datetime.fromisoformat(f"{day}T{clock}{zone or ''}")) + _fraction_ns(fraction)


def _read_german(text: str) -> int:
    day, month, year, hour, minute, second, fraction = _match(GERMAN, text)
    return _to_ns(
        datetime(int(year), int(month), int(day), int(hour), int(minute), int(second), tzinfo=UTC)
    ) + _fraction_ns(fraction)


def _read_clock(text: str) -> int:
    hour, minute, second, fraction = _match(CLOCK, text)
    return (int(hour) * 3600 + int(minute) * 60 + int(second)) * 1_000_000_000 + _fraction_ns(fraction)


def _match(pattern: re.Pattern[str], text: str) -> tuple[str, ...]:
    match = pattern.match(text)
    if match is None:
        raise ValueError(text)
    return match.groups()


def _fraction_ns(fraction: str | None) -> int:
    return int(fraction[1:].ljust(9, "0")) if fraction else 0


def _to_ns(moment: datetime) -> int:
    known = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    since = known - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1_000


def _unwrap_midnight(stamps: Stamps) -> Stamps:
    """Add a day after each step back by more than half a day."""
    days = np.cumsum(np.concatenate([[0], np.diff(stamps) < -DAY_NS // 2]))
    return np.asarray(stamps + days * DAY_NS)
