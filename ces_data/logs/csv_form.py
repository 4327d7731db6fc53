"""The form of a text table, from its first lines, and of its cells.

A table: encoding, delimiter, decimal mark, names and units of the columns. Cells: numbers, dates and times of day, the
spellings of a missing number, and comments.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np

from ces_data.limits import TableLimits
from ces_data.logs.log_mapping import DynoMapping
from ces_data.recording import Stamps
from ces_data.units import find_unit
from ces_observer.errors import RecordingError

SAMPLE_LINES, SAMPLE_BYTES = 200, 65_536
DELIMITERS = {"\t": "a tab", ";": "';'", "|": "'|'", ",": "','", " ": "a blank"}
NO_UNIT = frozenset({"", "-", "--", "1", "[-]", "(-)", "%", "[]"})
LINE_BREAK = re.compile(r"\s*[\r\n\t]\s*")  # in a quoted cell
LAST_ROWS = 20  # which say how wide the table is
Rows = list[tuple[int, list[str]]]  # number and cells of each line that is not blank
Header = tuple[int, tuple[str, ...], tuple[str, ...]]  # `head`, `names` and `units` of a dialect
DECIMALS = r"(?P<fraction>[.,]\d{1,9})"
FRACTION = r"(?P<fraction>[.,]\d{1,9}|:\d{3})?"  # controllers of machines write 12:00:00:125
TIME = r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)"
HALF = r"\s*(?P<half>[AaPp])?(?:\.?[Mm]\.?)?$"
ISO = re.compile(
    r"(?P<y>\d{4})-(?P<m>\d\d)-(?P<d>\d\d)[T _](?P<hour>\d\d):(?P<minute>\d\d)(?::(?P<second>\d\d))?"
    rf"{FRACTION}\s*(?P<zone>Z|[+-]\d\d:?\d\d)?$"
)
GERMAN = re.compile(rf"(?P<d>\d{{1,2}})\.(?P<m>\d{{1,2}})\.(?P<y>\d{{4}})[ _T]{TIME}{FRACTION}$")
NAMED = re.compile(rf"(?P<d>\d{{1,2}})[-. ]+(?P<m>[A-Za-zä]{{3,9}})[-. ]+(?P<y>\d{{4}})[ T]+{TIME}{FRACTION}$")
SLASHED = re.compile(rf"(?P<first>\d{{1,4}})/(?P<next>\d{{1,2}})/(?P<last>\d{{1,4}})[ T]+{TIME}{DECIMALS}?{HALF}")
CLOCK = re.compile(rf"(?:(?P<days>-?\d+) days? )?{TIME}{FRACTION}{HALF}")
MINUTES = re.compile(rf"(?P<minutes>\d{{1,3}}):(?P<second>\d\d){DECIMALS}$")
FORMS = (CLOCK, MINUTES, GERMAN, NAMED, SLASHED, ISO)
NAMES_OF_MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec"
MONTHS = {name: number for number, name in enumerate(NAMES_OF_MONTHS.split(), start=1)}
MONTHS |= {"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12}
HOUR_NS = 3_600_000_000_000
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,'’ \u00a0\u202f]\d{3})+([.,]\d+)?$")  # 1.234,5 or 1'234.5
WHOLE_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+$")
BINARY = {  # by its first bytes: what a file that is no text table is, and what to do
    b"PK": ("an Excel workbook or a zip archive", "save the sheet as CSV, or unpack it"),
    b"\xd0\xcf": ("an Excel workbook", "save the sheet as CSV"),
    b"\x1f\x8b": ("compressed with gzip", "unpack it"),
}
COMMENT_MARKS = ("#", "%", "//")
MISSING = frozenset(
    (
        *("na", "n/a", "#n/a", "#na", "#nv", "null", "none", "nil", "missing", "nan(ind)", "-nan(ind)", "?"),
        *("-", "--", "---", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf"),
        *("#div/0!", "#value!", "#wert!", "#num!", "#zahl!", "#ref!", "#bezug!"),
    )
)


@dataclass(frozen=True)
class CsvDialect:
    """The form of a text table; `head` is the number of lines that are not blank before the first row.

    `names` and `units` are the cells of those rows, empty if the file has none; `notes` say what was found.
    """

    encoding: str
    delimiter: str
    decimal: str
    head: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...] = ()


def find_dialect(path: Path, mapping: DynoMapping) -> CsvDialect:
    """Return the form of a file: what the mapping gives, and the rest from the first 200 lines."""
    encoding = _find_encoding(path)
    with path.open(encoding=encoding, errors="replace", newline="") as file:
        lines = [line for _, line in zip(range(SAMPLE_LINES), file, strict=False)]
    delimiters = [mapping.delimiter] if mapping.delimiter else list(DELIMITERS)
    decimals = [mapping.decimal] if mapping.decimal else [".", ","]
    choices = [(d, p) for d in delimiters for p in decimals if d != p]
    delimiter, decimal = max(choices, key=lambda choice: _fit(lines, *choice)) if len(choices) > 1 else choices[0]
    head, names, units = _find_header(_parse_lines(lines, delimiter), mapping.header_lines, decimal)
    notes = []
    if mapping.delimiter is None and delimiter != ",":
        notes.append(f"cells are separated by {DELIMITERS[delimiter]}")
    if mapping.decimal is None and decimal != ".":
        notes.append("decimals by ','")
    if units:
        notes.append(f"units in the header ({', '.join(unit or '-' for unit in units)})")
    return CsvDialect(encoding, delimiter, decimal, head, names, units, tuple(notes))


def _find_encoding(path: Path) -> str:
    """Return UTF-8, UTF-16, or else Windows' Western encoding; raises RecordingError if the file is not text."""
    with path.open("rb") as file:
        head = file.read(SAMPLE_BYTES)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    for name, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):  # without a mark, every second is zero
        if head and zeros.count(0) > 0.9 * len(zeros) and head.count(0) < 1.1 * len(zeros):
            return name
    if b"\0" in head:
        kind, remedy = BINARY.get(head[:2], ("binary data", "set format in the mapping if it has another"))
        raise RecordingError(f"{path}: not a text table, but {kind}; {remedy}")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _parse_lines(lines: Sequence[str], delimiter: str) -> Rows:
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]


def _fit(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[float, float]:
    """Return how well a form suits the last lines: cells that are numbers, in rows of one width; then fewer cells."""
    rows = [cells for _, cells in _parse_lines(lines, delimiter)][-LAST_ROWS:]
    if not rows:
        return 0.0, 0.0
    width, count = Counter(map(len, rows)).most_common(1)[0]
    cells = [cell for row in rows if len(row) == width for cell in row if cell.strip()]
    good = sum(is_number(cell, decimal) or is_date(cell) or is_missing(cell) for cell in cells)
    share = good / max(len(cells), 1) * count / len(rows)
    return (share if width > 1 else 0.5 * share), -width


def _find_header(rows: Rows, stated: int | None, decimal: str) -> Header:
    """Return the header among the first rows of a table; `stated` is the number of its lines, if that is known.

    The names are in the first line as wide as the table among those that stand directly above the numbers; lines of
    units and of one cell may stand between them.
    """
    widths = Counter(len(_strip_names(cells)) for _, cells in rows[-LAST_ROWS:])
    width = widths.most_common(1)[0][0] if widths else 0
    first_row = _find_first_row(rows, width, decimal) if stated is None else sum(number <= stated for number, _ in rows)
    if first_row == 0 or not rows:
        return 0, (), ()
    block = _name_lines(rows[:first_row], width, decimal)
    names_at = next((at for at in block if not _is_unit_row(rows[at][1])), None)
    units_at = next((at for at in block if _is_unit_row(rows[at][1])), None)
    if names_at is None:
        return 1 if first_row is None else first_row, (), ()
    if stated is None:  # the rows begin at the first line below the header that holds a number, though others be bad
        start = max(names_at, -1 if units_at is None else units_at) + 1
        numbered = (at for at in range(start, first_row or start) if any(is_number(c, decimal) for c in rows[at][1]))
        first_row = next(numbered, first_row)
    names = list(_strip_names(_strip_mark(rows[names_at][1])))
    for at in range(names_at + 1, first_row or len(rows)):  # a table's index is named in a line of its own by pandas
        for i, cell in enumerate([] if at in block else _strip_mark(rows[at][1])[: len(names)]):
            names[i] = names[i] or cell.strip()
    below = [rows[at][1] for at in block if at > names_at and not _is_unit_row(rows[at][1])]
    if len(set(names)) < len(names) and below:  # columns share the name of a group, before that in the next line
        joined = [" ".join(pair).strip() for pair in zip(names, _strip_names(below[0]), strict=False)]
        names = joined if len(set(joined)) == len(names) else names
    units = [] if units_at is None else [cell.strip().strip("[]()") for cell in _strip_mark(rows[units_at][1])]
    return names_at + 1 if first_row is None else first_row, tuple(names), tuple(units)


def _find_first_row(rows: Rows, width: int, decimal: str) -> int | None:
    """Return the index of the first row of numbers, None if no row is one.

    All its cells are numbers, dates or empty, and one is a number at least. In columns without any value, as those of
    a state or of remarks, any text may stand; a row with such text has values in half of the others at least.
    """
    texts = [_strip_names(cells) for _, cells in rows]
    wide = [row for row in texts if len(row) >= width]
    filled = {i for row in wide for i, text in enumerate(row) if text}
    words = filled - {i for row in wide for i, text in enumerate(row) if text and is_value(text, decimal)}
    for at, row in enumerate(texts):
        others = [text for i, text in enumerate(row) if i not in words]
        if len(rows[at][1]) < width or not any(is_number(text, decimal) for text in others):
            continue
        filled_enough = len(others) == len(row) or 2 * sum(map(bool, others)) >= width - len(words)
        if filled_enough and all(is_value(text, decimal) for text in others):
            return at
    return None


def _name_lines(rows: Rows, width: int, decimal: str) -> list[int]:
    """Return the indices of the last lines in a row that are as wide as the table and hold no number."""
    block: list[int] = []
    for at in reversed(range(len(rows))):
        names = _strip_names(_strip_mark(rows[at][1]))
        texts = [text for text in names if text]
        if any(is_number(text, decimal) or is_date(text) for text in texts):
            break
        if len(names) >= max(1, width):
            block.append(at)
        elif len(texts) > 1:
            break
    return block[::-1]


def _strip_names(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the names in a header line, without the empty ones after trailing delimiters."""
    names = [LINE_BREAK.sub(" ", cell.strip()) for cell in cells]
    while names and not names[-1]:
        names.pop()
    return tuple(names)


def _strip_mark(cells: Sequence[str]) -> list[str]:
    """Return the cells of a line without the mark of a comment at its beginning."""
    opening = cells[0].strip() if cells else ""
    mark = next((mark for mark in COMMENT_MARKS if opening.startswith(mark)), "")
    text = opening[len(mark) :].strip()
    return list(cells) if not mark else [text, *cells[1:]] if text else list(cells[1:])


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether all cells are units, or marks for none."""
    texts = [cell.strip() for cell in _strip_mark(cells)]
    units = [text for text in texts if find_unit(text) is not None]
    return bool(units) and all(text in units or text in NO_UNIT for text in texts)


class AmbiguousDateError(ValueError):
    """A date such as 05/01/2024, which may be in January or in May."""


def is_date(cell: str) -> bool:
    """Return whether a cell is a date or a time of day in some form."""
    return any(form.match(cell.strip()) for form in FORMS)


def parse_dates(cells: Sequence[str], pattern: str, before: int = 0) -> Stamps:
    """Return the times of cells in nanoseconds since 1970, UTC if they state no zone; times of day count from midnight.

    Without a `pattern` (as in `datetime.strptime`) ISO 8601, 31.12.2024 23:59:59.5, 31-Dec-2024 23:59:59.5,
    12/31/2024 11:59:59.5 PM, 23:59:59.5, 59:59.5 (minutes and seconds) and `0 days 23:59:59.5` are read. Raises
    ValueError for the first cell that is not a time, with its row after `before` ones as second argument;
    AmbiguousDateError if it may have two meanings.
    """
    ends = [cell.strip() for cell in (cells[0], cells[-1])] if cells else [""]
    form = next((form for form in FORMS if form.match(ends[0])), ISO)
    order = _find_order([m for text in ends if (m := SLASHED.match(text))]) if form is SLASHED and not pattern else ""
    stamps = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        try:
            match = None if pattern else form.match(cell.strip())
            if pattern:
                stamps[row] = _since_1970(datetime.strptime(cell.strip(), pattern))
            elif match:
                stamps[row] = _read_parts(match.groupdict(), order)
            else:
                raise ValueError(cell)
        except ValueError:
            raise ValueError(cell, row - before) from None
    period = 0 if pattern else {CLOCK: 24 * HOUR_NS, MINUTES: HOUR_NS}.get(form, 0)
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
        days = date(int(year), month, int(day["d"] or 0)).toordinal() - date(1970, 1, 1).toordinal()
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
