"""Times as text: dates with a time of day, or a time of day alone, into nanoseconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from ces_identify.recordings.recording import Stamps

FRACTION = r"([.,]\d{1,9}|:\d{3})?"  # controllers of machines write 12:00:00:125
ISO = re.compile(rf"(\d{{4}}-\d\d-\d\d)[T _](\d\d:\d\d(?::\d\d)?){FRACTION}\s*(Z|[+-]\d\d:?\d\d)?$")
GERMAN = re.compile(rf"(\d{{1,2}})\.(\d{{1,2}})\.(\d{{4}})[ _T](\d{{1,2}}):(\d\d):(\d\d){FRACTION}$")
NAMED = re.compile(rf"(\d{{1,2}})[-. ]+([A-Za-zä]{{3,9}})[-. ]+(\d{{4}})[ T]+(\d{{1,2}}):(\d\d):(\d\d){FRACTION}$")
MONTHS = {
    "jan": 1,
    "feb": 2,
    "mar": 3,
    "apr": 4,
    "may": 5,
    "jun": 6,
    "jul": 7,
    "aug": 8,
    "sep": 9,
    "oct": 10,
    "nov": 11,
}
MONTHS |= {"dec": 12, "mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
CLOCK = re.compile(rf"(?:(-?\d+) days? )?(\d{{1,2}}):(\d\d):(\d\d){FRACTION}\s*([AaPp])?(?:\.?[Mm]\.?)?$")
MINUTES = re.compile(r"(\d{1,3}):(\d\d)([.,]\d{1,9})$")
DAY_NS = 86_400_000_000_000
SLASHED = re.compile(r"(\d{1,4})/(\d{1,2})/(\d{1,4})[ T]+(\d{1,2}:\d\d:\d\d)([.,]\d{1,9})?\s*([AaPp])?(?:\.?[Mm]\.?)?$")
HOUR_NS = 3_600_000_000_000


class AmbiguousDateError(ValueError):
    """A date such as 05/01/2024, which may be in January or in May."""


def is_date(cell: str) -> bool:
    """Return whether a cell is a date or a time of day in some form."""
    text = cell.strip()
    return any(pattern.match(text) for pattern in (ISO, GERMAN, NAMED, CLOCK, MINUTES, SLASHED))


def parse_dates(cells: Sequence[str], pattern: str) -> Stamps:
    """Return the times of cells in nanoseconds since 1970, UTC if they state no zone; times of day count from midnight.

    Without a `pattern` (as in `datetime.strptime`) ISO 8601, 31.12.2024 23:59:59.5, 31-Dec-2024 23:59:59.5,
    12/31/2024 11:59:59.5 PM, 23:59:59.5, 59:59.5 (minutes and seconds) and `0 days 23:59:59.5` are read. Raises
    ValueError for the first cell that is not a time, with its row as second argument; AmbiguousDateError if it may have
    two meanings.
    """
    read = _reader([cell.strip() for cell in (cells[0], cells[-1])] if cells else [""], pattern)
    stamps = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        try:
            stamps[row] = read(cell.strip())
        except (ValueError, AttributeError):
            raise ValueError(cell, row) from None
    period = DAY_NS if read is _read_clock else HOUR_NS if read is _read_minutes else 0
    return _unwrap(stamps, period) if period else stamps


def _reader(ends: Sequence[str], pattern: str) -> Callable[[str], int]:
    """Return the function that reads the times of a column, by the form of its first and last cell."""
    first = ends[0]
    if pattern:
        return lambda text: _to_ns(datetime.strptime(text, pattern))
    if SLASHED.match(first):
        order = _find_order([match for text in ends if (match := SLASHED.match(text))])
        return lambda text: _read_slashed(text, order)
    readers = {CLOCK: _read_clock, MINUTES: _read_minutes, GERMAN: _read_german, NAMED: _read_named}
    return next((read for form, read in readers.items() if form.match(first)), _read_iso)


def _find_order(matches: Sequence[re.Match[str]]) -> str:
    """Return the order of year, month and day, such as `mdy`; raises AmbiguousDateError if it cannot be known."""
    if len(matches[0].group(1)) == 4:
        return "ymd"
    firsts, seconds = ([int(match.group(i)) for match in matches] for i in (1, 2))
    if max(seconds) > 12 or matches[0].group(6):  # a clock of twelve hours is American
        return "mdy"
    if max(firsts) > 12 or firsts == seconds:
        return "dmy"
    raise AmbiguousDateError(matches[0].group(0))


def _read_slashed(text: str, order: str) -> int:
    *day, clock, fraction, half = _match(SLASHED, text)
    parts = dict(zip(order, map(int, day), strict=True))
    hour, minute, second = map(int, clock.split(":"))
    moment = datetime(parts["y"], parts["m"], parts["d"], _hour_of_day(hour, half), minute, second, tzinfo=UTC)
    return _to_ns(moment) + _fraction_ns(fraction)


def _hour_of_day(hour: int, half: str | None) -> int:
    """Return the hour of 24 from one of 12 with its half of the day, `a` or `p`."""
    if half is None:
        return hour
    if not 1 <= hour <= 12:
        raise ValueError(hour)
    return hour % 12 + (12 if half in "Pp" else 0)


def _read_iso(text: str) -> int:
    day, clock, fraction, zone = _match(ISO, text)
    return _to_ns(datetime.fromisoformat(f"{day}T{clock}{zone or ''}")) + _fraction_ns(fraction)


def _read_german(text: str) -> int:
    day, month, *clock, fraction = _match(GERMAN, text)
    return _moment_ns(int(day), int(month), clock) + _fraction_ns(fraction)


def _read_named(text: str) -> int:
    day, name, *clock, fraction = _match(NAMED, text)
    if name[:3].casefold() not in MONTHS:
        raise ValueError(text)
    return _moment_ns(int(day), MONTHS[name[:3].casefold()], clock) + _fraction_ns(fraction)


def _moment_ns(day: int, month: int, clock: Sequence[str]) -> int:
    year, hour, minute, second = map(int, clock)
    return _to_ns(datetime(year, month, day, hour, minute, second, tzinfo=UTC))


def _read_clock(text: str) -> int:
    days, hour, minute, second, fraction, half = _match(CLOCK, text)
    seconds = _hour_of_day(int(hour), half) * 3600 + int(minute) * 60 + int(second)
    return int(days or 0) * DAY_NS + seconds * 1_000_000_000 + _fraction_ns(fraction)


def _read_minutes(text: str) -> int:
    minute, second, fraction = _match(MINUTES, text)
    return (int(minute) * 60 + int(second)) * 1_000_000_000 + _fraction_ns(fraction)


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


def _unwrap(stamps: Stamps, period_ns: int) -> Stamps:
    """Add a period, a day or an hour, after each step back by more than half of it."""
    periods = np.cumsum(np.concatenate([[0], np.diff(stamps) < -period_ns // 2]))
    return np.asarray(stamps + periods * period_ns)
