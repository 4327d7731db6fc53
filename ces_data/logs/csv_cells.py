"""Cells of text tables: numbers, dates and times of day, the spellings of a missing number, and comments."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial

import numpy as np

from ces_data.recording import Stamps

FRACTION = r"([.,]\d{1,9}|:\d{3})?"  # controllers of machines write 12:00:00:125
ISO = re.compile(rf"(\d{{4}}-\d\d-\d\d)[T _](\d\d:\d\d(?::\d\d)?){FRACTION}\s*(Z|[+-]\d\d:?\d\d)?$")
GERMAN = re.compile(rf"(\d{{1,2}})\.(\d{{1,2}})\.(\d{{4}})[ _T](\d{{1,2}}):(\d\d):(\d\d){FRACTION}$")
NAMED = re.compile(rf"(\d{{1,2}})[-. ]+([A-Za-zä]{{3,9}})[-. ]+(\d{{4}})[ T]+(\d{{1,2}}):(\d\d):(\d\d){FRACTION}$")
NAMES_OF_MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec"
MONTHS = {name: number for number, name in enumerate(NAMES_OF_MONTHS.split(), start=1)}
MONTHS |= {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
CLOCK = re.compile(rf"(?:(-?\d+) days? )?(\d{{1,2}}):(\d\d):(\d\d){FRACTION}\s*([AaPp])?(?:\.?[Mm]\.?)?$")
MINUTES = re.compile(r"(\d{1,3}):(\d\d)([.,]\d{1,9})$")
SLASHED = re.compile(
    r"(\d{1,4})/(\d{1,2})/(\d{1,4})[ T]+(\d{1,2}):(\d\d):(\d\d)([.,]\d{1,9})?\s*([AaPp])?(?:\.?[Mm]\.?)?$"
)
HOUR_NS = 3_600_000_000_000
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,'’ \u00a0\u202f]\d{3})+([.,]\d+)?$")  # 1.234,5 or 1'234.5
WHOLE_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+$")
MIN_MIXED = 3
COMMENT_MARKS = ("#", "%", "//")
MISSING = frozenset(
    (
        *("na", "n/a", "#n/a", "#na", "#nv", "null", "none", "nil", "missing", "nan(ind)", "-nan(ind)", "?"),
        *("-", "--", "---", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf"),
        *("#div/0!", "#value!", "#wert!", "#num!", "#zahl!", "#ref!", "#bezug!"),
    )
)


class AmbiguousDateError(ValueError):
    """A date such as 05/01/2024, which may be in January or in May."""


def is_date(cell: str) -> bool:
    """Return whether a cell is a date or a time of day in some form."""
    text = cell.strip()
    return any(pattern.match(text) for pattern in READERS)


def parse_dates(cells: Sequence[str], pattern: str) -> Stamps:
    """Return the times of cells in nanoseconds since 1970, UTC if they state no zone; times of day count from midnight.

    Without a `pattern` (as in `datetime.strptime`) ISO 8601, 31.12.2024 23:59:59.5, 31-Dec-2024 23:59:59.5,
    12/31/2024 11:59:59.5 PM, 23:59:59.5, 59:59.5 (minutes and seconds) and `0 days 23:59:59.5` are read. Raises
    ValueError for the first cell that is not a time, with its row as second argument; AmbiguousDateError if it may have
    two meanings.
    """
    ends = [cell.strip() for cell in (cells[0], cells[-1])] if cells else [""]
    form = next((form for form in READERS if form.match(ends[0])), ISO)
    read = READERS[form]
    if form is SLASHED and not pattern:
        read = partial(read, order=_find_order([match for text in ends if (match := SLASHED.match(text))]))

    def read_cell(text: str) -> int:
        if pattern:
            return _to_ns(datetime.strptime(text, pattern))
        match = form.match(text)
        if match is None:
            raise ValueError(text)
        return read(*match.groups())

    stamps = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        try:
            stamps[row] = read_cell(cell.strip())
        except ValueError:
            raise ValueError(cell, row) from None
    period = 0 if pattern else {CLOCK: 24 * HOUR_NS, MINUTES: HOUR_NS}.get(form, 0)
    if not period:
        return stamps
    passed = np.cumsum(np.concatenate([[0], np.diff(stamps) < -period // 2]))  # midnights, or full hours
    return np.asarray(stamps + passed * period)


def _find_order(matches: Sequence[re.Match[str]]) -> str:
    """Return the order of year, month and day, such as `mdy`; raises AmbiguousDateError if it cannot be known."""
    if len(matches[0].group(1)) == 4:
        return "ymd"
    firsts, seconds = ([int(match.group(i)) for match in matches] for i in (1, 2))
    if max(seconds) > 12 or matches[0].group(8):  # a clock of twelve hours is American
        return "mdy"
    if max(firsts) > 12 or firsts == seconds:
        return "dmy"
    raise AmbiguousDateError(matches[0].group(0))


def _read_iso(day: str, clock: str, fraction: str | None, zone: str | None) -> int:
    return _to_ns(datetime.fromisoformat(f"{day}T{clock}{zone or ''}")) + _fraction_ns(fraction)


def _read_german(day: str, month: str, year: str, hour: str, minute: str, second: str, fraction: str | None) -> int:
    moment = datetime(int(year), int(month), int(day), int(hour), int(minute), int(second), tzinfo=UTC)
    return _to_ns(moment) + _fraction_ns(fraction)


def _read_named(day: str, name: str, *rest: str) -> int:
    if name[:3].casefold() not in MONTHS:
        raise ValueError(name)
    return _read_german(day, str(MONTHS[name[:3].casefold()]), *rest)


def _read_slashed(
    a: str, b: str, c: str, hour: str, minute: str, second: str, fraction: str | None, half: str | None, order: str = ""
) -> int:
    parts = dict(zip(order, (a, b, c), strict=True))
    hours = str(_hour_of_day(int(hour), half))
    return _read_german(parts["d"], parts["m"], parts["y"], hours, minute, second, fraction)


def _read_clock(
    days: str | None, hour: str, minute: str, second: str, fraction: str | None, half: str | None = None
) -> int:
    if int(minute) > 59 or int(second) > 59:
        raise ValueError(minute, second)
    minutes = 60 * (24 * int(days or 0) + _hour_of_day(int(hour), half)) + int(minute)
    return (60 * minutes + int(second)) * 1_000_000_000 + _fraction_ns(fraction)


def _read_minutes(minute: str, second: str, fraction: str) -> int:
    if int(second) > 59:
        raise ValueError(second)
    return (60 * int(minute) + int(second)) * 1_000_000_000 + _fraction_ns(fraction)


def _hour_of_day(hour: int, half: str | None) -> int:
    """Return the hour of 24 from one of 12 with its half of the day, `a` or `p`."""
    if half is None:
        return hour
    if not 1 <= hour <= 12:
        raise ValueError(hour)
    return hour % 12 + (12 if half in "Pp" else 0)


def _fraction_ns(fraction: str | None) -> int:
    return int(fraction[1:].ljust(9, "0")) if fraction else 0


def _to_ns(moment: datetime) -> int:
    known = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    since = known - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1_000


READERS: Mapping[re.Pattern[str], Callable[..., int]] = {
    **{CLOCK: _read_clock, MINUTES: _read_minutes, GERMAN: _read_german, NAMED: _read_named},
    **{SLASHED: _read_slashed, ISO: _read_iso},
}


def parse_number(cell: str, decimal: str) -> float:
    """Return the number in a cell; raises ValueError if it is none, as 1.234 with a decimal comma, or 1_000."""
    if "_" in cell or (decimal != "." and "." in cell):
        raise ValueError(cell)
    return float(cell.replace(decimal, "."))


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number."""
    try:
        parse_number(cell, decimal)
    except ValueError:
        return False
    return True


def is_grouped(cell: str) -> bool:
    """Return whether a cell is a number with thousands separators, or may be one."""
    return GROUPED.match(cell.strip()) is not None


def mixes_groups(cells: Sequence[str], decimal: str) -> bool:
    """Return whether whole numbers up to 999 stand beside 1.234, with three digits behind every mark: thousands."""
    marked = [cell.strip() for cell in cells if decimal in cell]
    whole = [cell.strip().lstrip("+-") for cell in cells if decimal not in cell and cell.strip()]
    return (
        min(len(marked), len(whole)) >= MIN_MIXED
        and all(WHOLE_GROUPS.match(cell) for cell in marked)
        and all(cell.isdecimal() and len(cell) <= 3 for cell in whole)
    )


def is_value(cell: str, decimal: str) -> bool:
    """Return whether a cell is what a row of numbers has: a number in any spelling, a date, or none that is missing."""
    known = is_number(cell, decimal) or is_date(cell) or is_grouped(cell)
    return known or not cell.strip() or is_missing(cell)


def is_missing(cell: str) -> bool:
    """Return whether a cell is one of the ways in which programs write that there is no number."""
    return cell.strip().casefold() in MISSING


def is_comment(cells: Sequence[str]) -> bool:
    """Return whether a line is a comment, by the mark with which it begins."""
    first = cells[0].lstrip() if cells else ""
    return first.startswith(COMMENT_MARKS) and not is_missing(first)
