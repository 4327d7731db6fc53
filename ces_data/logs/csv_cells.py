"""The cells of a text table: numbers, dates and times of day, and the spellings of a missing number."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime, timedelta
from functools import cache

import numpy as np

from ces_data.limits import TableLimits
from ces_data.recording import Stamps

DECIMALS = r"(?P<fraction>[.,]\d{1,9})"
FRACTION = r"(?P<fraction>[.,]\d{1,9}|:\d{3})?"  # controllers of machines write 12:00:00:125
TIME = r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)"
HALF = r"\s*(?P<half>[AaPp])?(?:\.?[Mm]\.?)?$"
ISO = re.compile(
    r"(?P<y>\d{4})-(?P<m>\d\d)-(?P<d>\d\d)[T _](?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d))?"
    rf"{FRACTION}\s*(?P<zone>Z|[+-]\d\d:?\d\d)?$"
)
GERMAN = re.compile(rf"(?P<d>\d{{1,2}})\.(?P<m>\d{{1,2}})\.(?P<y>\d{{4}}|\d\d)[ _T]{TIME}{FRACTION}$")
NAMED = re.compile(rf"(?P<d>\d{{1,2}})[-. ]+(?P<m>[A-Za-zä]{{3,9}})[-. ]+(?P<y>\d{{4}})[ T]+{TIME}{FRACTION}$")
SLASHED = re.compile(rf"(?P<first>\d{{1,4}})/(?P<next>\d{{1,2}})/(?P<last>\d{{1,4}})[ T]+{TIME}{DECIMALS}?{HALF}")
CLOCK = re.compile(rf"(?:(?P<days>-?\d+) days? )?{TIME}{FRACTION}{HALF}")
C_STYLE = re.compile(  # of C and Java: Wed Aug 05 18:57:50.004 GMT+01:00 2026
    rf"[A-Za-z]{{3}} (?P<m>[A-Za-z]{{3}}) +(?P<d>\d{{1,2}}) {TIME}{FRACTION} "
    r"(?:(?:GMT|UTC)?(?P<zone>[+-]\d\d:?\d\d)? )?(?P<y>\d{4})$"
)
MINUTES = re.compile(rf"(?P<minutes>\d{{1,3}}):(?P<second>\d\d){DECIMALS}$")
DURATION = re.compile(r"(?P<number>-?\d+(?:\.\d+)?(?:e[-+]?\d+)?) ?(?P<of>sec|min|hr)$")  # of MATLAB
DURATIONS_S = {"sec": 1.0, "min": 60.0, "hr": 3600.0}
FORMS = (DURATION, CLOCK, MINUTES, GERMAN, NAMED, SLASHED, C_STYLE, ISO)
NAMES_OF_MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec"
MONTHS = {name: number for number, name in enumerate(NAMES_OF_MONTHS.split(), start=1)}
MONTHS |= {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
DAY = re.compile("%[dejDFcxsu]")  # in a pattern: it states a date
HOUR_NS = 3_600_000_000_000
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,'’ \u00a0\u202f]\d{3})+([.,]\d+)?$")  # 1.234,5 or 1'234.5
MINUS = {0x2212: "-"}  # U+2212, as R and Matplotlib write it
FORTRAN = re.compile(r"(\d\.?)[Dd]([+-]?\d+)$")
WHOLE_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+$")
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
    return any(form.match(cell.strip()) for form in FORMS)


def parse_dates(cells: Sequence[str], pattern: str, before: int = 0) -> Stamps:
    """Return the times of cells in nanoseconds since 1970, UTC if they state no zone; times of day count from midnight.

    Without a `pattern` (as in `datetime.strptime`) ISO 8601, 31.12.2024 23:59:59.5, 31-Dec-2024 23:59:59.5,
    12/31/2024 11:59:59.5 PM, 23:59:59.5, 59:59.5 (minutes and seconds), `0 days 23:59:59.5` and `0.002 sec` are read.
    Raises ValueError for the first cell that is not a time, with its row after `before` ones as second argument;
    AmbiguousDateError if it may have two meanings.
    """
    ends = [cell.strip() for cell in (cells[0], cells[-1])] if cells else [""]
    form = next((form for form in FORMS if form.match(ends[0])), ISO)
    order = _find_order([m for text in ends if (m := SLASHED.match(text))]) if form is SLASHED and not pattern else ""
    of_day = bool(pattern) and not DAY.search(pattern)
    start_ns = _since_1970(datetime(1900, 1, 1)) if of_day else 0
    stamps = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        try:
            match = None if pattern else form.match(cell.strip())
            if pattern:
                stamps[row] = _since_1970(datetime.strptime(cell.strip(), pattern)) - start_ns
            elif match:
                stamps[row] = _read_parts(match.groupdict(), order)
            else:
                raise ValueError(cell)
        except ValueError:
            raise ValueError(cell, row - before) from None
    period = 24 * HOUR_NS * of_day if pattern else {CLOCK: 24 * HOUR_NS, MINUTES: HOUR_NS}.get(form, 0)
    if not period:
        return stamps
    passed = np.cumsum(np.concatenate([[0], np.diff(stamps) < -period // 2]))  # midnights, or full hours
    return np.asarray(stamps + passed * period)


def _find_order(matches: Sequence[re.Match[str]]) -> str:
    """Return the order of year, month and day, such as `mdy`; raises AmbiguousDateError if it cannot be known."""
    if len(matches[0]["first"]) == 4:
        return "ymd"
    firsts, seconds = ([int(match[i]) for match in matches] for i in ("first", "next"))
    if max(seconds) > 12 or matches[0]["half"]:  # a clock of twelve hours is American
        return "mdy"
    if max(firsts) > 12 or firsts == seconds:
        return "dmy"
    raise AmbiguousDateError(matches[0][0])


def _read_parts(part: Mapping[str, str | None], order: str) -> int:
    """Return the time [ns] since 1970, or since midnight without a date; raises ValueError if there is none such."""
    if number := part.get("number"):
        return round(float(number) * DURATIONS_S[str(part["of"])] * 1e9)
    hour, minute, second = (int(part.get(key) or 0) for key in ("hour", "minute", "second"))
    if half := part.get("half"):
        if not 1 <= hour <= 12:
            raise ValueError(hour)
        hour = hour % 12 + (12 if half in "Pp" else 0)
    days = int(part.get("days") or 0)
    day = part if not order else dict(zip(order, (part["first"], part["next"], part["last"]), strict=True))
    if year := day.get("y"):
        name = str(day["m"])
        month = int(name) if name.isdigit() else MONTHS.get(name[:3].casefold(), 0)
        days = (
            date(int(year) + 2000 * (len(year) == 2), month, int(day["d"] or 0)).toordinal()
            - date(1970, 1, 1).toordinal()
        )
    if minute > 59 or second > 59 or (year and hour > 23):
        raise ValueError(hour, minute, second)
    minutes = 60 * (24 * days + hour) + minute + int(part.get("minutes") or 0)
    fraction = part.get("fraction") or ".0"
    seconds = 60 * minutes + second - _offset_s(part.get("zone") or "Z")
    return seconds * 1_000_000_000 + int(fraction[1:].ljust(9, "0"))


@cache
def _offset_s(zone: str) -> int:
    """Return by how much a zone such as `+01:00` is ahead of UTC [s]."""
    moment = datetime.strptime(zone, "%z")
    return round((moment.replace(tzinfo=UTC) - moment).total_seconds())


def _since_1970(moment: datetime) -> int:
    in_zone = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return (in_zone - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1_000


def parse_number(cell: str, decimal: str) -> float:
    """Return the number in a cell; raises ValueError if it is none, as 1.234 with a decimal comma, or 1_000.

    A minus may be that of typesetting, an exponent Fortran's: -1.5D-03.
    """
    if "_" in cell or (decimal != "." and "." in cell):
        raise ValueError(cell)
    text = cell.replace(decimal, ".")
    try:
        return float(text)
    except ValueError:
        return float(FORTRAN.sub(r"\1e\2", text.translate(MINUS)))


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
        min(len(marked), len(whole)) >= TableLimits.MIN_MIXED
        and all(WHOLE_GROUPS.match(cell) for cell in marked)
        and all(cell.isdecimal() and len(cell) <= 3 for cell in whole)
    )


def is_value(cell: str, decimal: str) -> bool:
    """Return whether a cell is what a row of numbers has: a number in any spelling, a date, or none that is missing."""
    is_written = is_number(cell, decimal) or is_date(cell) or is_grouped(cell)
    return is_written or not cell.strip() or is_missing(cell)


def is_missing(cell: str) -> bool:
    """Return whether a cell is one of the ways in which programs write that there is no number."""
    return cell.strip().casefold() in MISSING
