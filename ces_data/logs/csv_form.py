"""The form of a text table, from its first lines: encoding, delimiter, decimal mark, names and units of the columns."""

from __future__ import annotations

import codecs
import csv
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from ces_data.limits import TableLimits
from ces_data.logs.csv_cells import is_date, is_missing, is_number, is_value, parse_number
from ces_data.logs.log_mapping import DynoMapping
from ces_data.units import find_unit
from ces_observer.errors import RecordingError

SAMPLE_LINES, SAMPLE_BYTES = 200, 65_536
DELIMITERS = {"\t": "a tab", ";": "';'", "|": "'|'", ",": "','", " ": "a blank"}
NO_UNIT = frozenset({"", "-", "--", "1", "[-]", "(-)", "%", "[]"})
OTHERS = (  # units of columns that are no signal
    "km bar mbar Pa hPa kPa MPa psi deg ° rad deg/s °/s rad/s rpm 1/min min-1 U/min Hz kHz Nm kNm W kW J Ohm Ω l/min "
    "ml cc kg # count counts lap bool mV/V µm/m ppm %RH"
)
OTHER_UNITS = frozenset(OTHERS.split())
UNIT_LABELS = frozenset(("unit", "units", "einheit", "einheiten", "y_unit_label", "vertical units"))  # before units
LINE_BREAK = re.compile(r"\s*[\r\n\t]\s*")  # in a quoted cell
MIN_NUMBERED = 3  # columns in a row that numbers them
DESCRIBED = re.compile(r'"?(\w[^|"]*)"?\|"?([^|"]*)"?(?:\|[-+.\d]+){2,3}$')  # RaceCapture's: name, unit, range, rate
WIDE_BLANK = re.compile(r"\t+|\s{2,}")
RATE = re.compile(  # in a line above the names: `Sample Rate: 1000 Hz`, `Abtastrate [Hz];1000`
    r"(?:sampl\w*|scan|abtast)[ _-]*(?:rate|freq\w*)\W*(k?Hz)?\W*(\d+(?:[.,]\d+)?) *(k?Hz)?", re.IGNORECASE
)
LAST_ROWS = 20  # which say how wide the table is
Rows = list[tuple[int, list[str]]]  # number and cells of each line that is not blank
Header = tuple[int, tuple[str, ...], tuple[str, ...], int]  # `head`, `names`, `units`, `names_line` of a dialect
BINARY = {  # by its first bytes: what a file that is no text table is, and what to do
    b"PK": ("an Excel workbook or a zip archive", "save the sheet as CSV, or unpack it"),
    b"\xd0\xcf": ("an Excel workbook", "save the sheet as CSV"),
    b"\x1f\x8b": ("compressed with gzip", "unpack it"),
    b"version https://git-lfs": ("a pointer of Git LFS to one", "fetch it: git lfs pull"),
}
TEXT = re.compile(rb"[\t\n\r\x20-\xff]*")
COMMENT_MARKS = ("#", "%", "//")
REMARKS = frozenset(
    ("", "comment", "comments", "remark", "remarks", "note", "notes", "kommentar", "bemerkung")
)  # names


@dataclass(frozen=True)
class CsvDialect:
    """The form of a text table; `head` is the number of lines that are not blank before the first row.

    `names` and `units` are the cells of those rows, empty if the file has none; `names_line` is the number of the line
    with the names, 0 without; `notes` say what was found; `stated_Hz` is the rate that the header states, 0 without.
    """

    encoding: str
    delimiter: str
    decimal: str
    head: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...] = ()
    names_line: int = 0
    stated_Hz: float = 0.0


def find_other_unit(text: str) -> str:
    """Return a unit that no signal has, as `%` or `mV/V`, or a sensitivity as `500 N/V`, from a unit or a name."""
    bracketed = re.search(r"[\[(]([^\[\]()]+)[\])]\s*$", text)
    stated = (bracketed.group(1) if bracketed else text.rpartition("_")[2]).strip()
    return stated if stated in {"%", *OTHER_UNITS} or (bracketed and stated.endswith(("/V", "/mV"))) else ""


def find_dialect(path: Path, mapping: DynoMapping) -> CsvDialect:
    """Return the form of a file: what the mapping gives, and the rest from the first 200 lines."""
    encoding = _find_encoding(path)
    with path.open(encoding=encoding, errors="replace", newline="") as file:
        lines = [line for _, line in zip(range(SAMPLE_LINES), file, strict=False)]
    delimiters = [mapping.delimiter] if mapping.delimiter else list(DELIMITERS)
    decimals = [mapping.decimal] if mapping.decimal else [".", ","]
    quoted = any('"' in line for line in lines[-LAST_ROWS:])  # where a comma may be both
    choices = [(d, p) for d in delimiters for p in decimals if d != p or quoted]
    delimiter, decimal = max(choices, key=lambda choice: _fit(lines, *choice)) if len(choices) > 1 else choices[0]
    head, names, units, names_line = find_header(parse_lines(lines, delimiter), mapping.header_lines, decimal)
    if delimiter == " " and names:  # names of several words, with more blanks between them
        wide = tuple(WIDE_BLANK.split(lines[names_line - 1].strip()))
        names = wide if 1 < len(wide) == _usual_width(parse_lines(lines[names_line:], delimiter)) else names
    notes = []
    if mapping.delimiter is None and delimiter != ",":
        notes.append(f"cells are separated by {DELIMITERS[delimiter]}")
    if mapping.decimal is None and decimal != ".":
        notes.append("decimals by ','")
    if units:
        notes.append(f"units in the header ({', '.join(unit or '-' for unit in units)})")
    stated_Hz = _find_rate(lines[: max(names_line - 1, 0)])
    return CsvDialect(encoding, delimiter, decimal, head, names, units, tuple(notes), names_line, stated_Hz)


def _find_rate(lines: Sequence[str]) -> float:
    """Return the rate of sampling that a header states with its unit [Hz], 0 if it states none."""
    for match in filter(None, map(RATE.search, lines)):
        if unit := match[1] or match[3]:
            return float(match[2].replace(",", ".")) * (1e3 if len(unit) > 2 else 1.0)
    return 0.0


def _find_encoding(path: Path) -> str:
    """Return UTF-8, UTF-16, or else Windows' Western encoding; raises RecordingError if the file is not text."""
    with path.open("rb") as file:
        head = file.read(SAMPLE_BYTES)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    for name, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):  # without a mark, every second is zero
        if head and zeros.count(0) > 0.9 * len(zeros) and head.count(0) < 1.1 * len(zeros):
            return name
    known = next((what for begin, what in BINARY.items() if head.startswith(begin)), None)
    if b"\0" in head or known:
        if not known:
            _refuse_zeros(path, head)
        kind, remedy = known or ("binary data", "set format in the mapping if it has another")
        raise RecordingError(f"{path}: not a text table, but {kind}; {remedy}")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _refuse_zeros(path: Path, head: bytes) -> None:
    """Raise RecordingError that names the place of the first zero byte, if the other bytes are text."""
    if head.count(0) > TableLimits.MAX_ZERO_SHARE * len(head) or not TEXT.fullmatch(head.replace(b"\0", b"")):
        return
    first = head.index(0)
    line, byte = head.count(b"\n", 0, first) + 1, first - head.rfind(b"\n", 0, first)
    count, file = len(head[first:]) - len(head[first:].lstrip(b"\0")), shlex.quote(str(path))
    clean = shlex.quote(f"{path.stem}_clean{path.suffix}")
    remedy = f"remove them, and then what else is damaged in these lines: tr -d '\\000' < {file} > {clean}"
    lost = "as a serial line leaves where it was interrupted"
    raise RecordingError(f"{path}:{line}: {count} zero bytes from byte {byte} of the line on, {lost}; {remedy}")


def parse_lines(lines: Sequence[str], delimiter: str) -> Rows:
    """Return the lines that are not blank."""
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]


def _fit(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[float, float]:
    """Return how well a form suits the last lines: cells that are numbers, in rows of one width; then fewer cells."""
    rows = [cells for _, cells in parse_lines(lines, delimiter)][-LAST_ROWS:]
    if not rows:
        return 0.0, 0.0
    width, count = Counter(map(len, rows)).most_common(1)[0]
    cells = [cell for row in rows if len(row) == width for cell in row if cell.strip()]
    good = sum(is_number(cell, decimal) or is_date(cell) or is_missing(cell) for cell in cells)
    share = good / max(len(cells), 1) * count / len(rows)
    return (share if width > 1 else 0.5 * share), -width


def find_header(rows: Rows, stated: int | None, decimal: str) -> Header:
    """Return the header among the first rows of a table; `stated` is the number of its lines, if that is known.

    The names are in the first line as wide as the table among those that stand directly above the numbers; lines of
    units and of one cell may stand between them.
    """
    width = _usual_width(rows)
    first_row = _find_first_row(rows, width, decimal) if stated is None else sum(number <= stated for number, _ in rows)
    if first_row == 0 or not rows:
        return 0, (), (), 0
    block = _name_lines(rows[:first_row], width, decimal)
    names_at = next((at for at in block if not _is_unit_row(rows[at][1])), None)
    units_at = next((at for at in block if _is_unit_row(rows[at][1])), None)
    if units_at is None:
        units_at = find_labelled_units(rows[: first_row or max(block, default=0)])
    if names_at is None:
        return 1 if first_row is None else first_row, (), (), 0
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
    units = [] if units_at is None else list(strip_units(rows[units_at][1]))
    head = names_at + 1 if first_row is None else first_row
    head += stated is None and _numbers_columns([cells for _, cells in rows[head : head + 2]], bool(units), decimal)
    if not units and all(parts := [DESCRIBED.match(name) for name in names]):
        names, units = ([str(part[i]) for part in parts if part] for i in (1, 2))
    return head, tuple(names), tuple(units), rows[names_at][0]


def _numbers_columns(rows: Sequence[Sequence[str]], has_units: bool, decimal: str) -> bool:
    """Return whether the first of two rows holds numbers of channels (1, 2, 3, ...), or their rates, below a header."""
    if len(rows) < 2:
        return False
    first, below = (_strip_names(cells) for cells in rows)
    if len(first) < MIN_NUMBERED or not below or not all(cell.isdecimal() for cell in first):
        return False
    numbers = list(map(int, first))
    counted = numbers == list(range(numbers[0], numbers[0] + len(numbers))) and numbers[0] <= 1
    falls = is_number(below[0], decimal) and parse_number(below[0], decimal) < numbers[0]
    plain = all(cell.lstrip("+-").isdecimal() for cell in below)
    return (counted and (falls or (has_units and not plain))) or (len(set(numbers)) == 1 and falls)


def _usual_width(rows: Rows) -> int:
    """Return how many cells most of the last rows have, without empty ones at their ends."""
    widths = Counter(len(_strip_names(cells)) for _, cells in rows[-LAST_ROWS:])
    return widths.most_common(1)[0][0] if widths else 0


def explain_width(cells: Sequence[str], width: int, delimiter: str) -> str:
    """Return why a line may have another number of cells than the table, and what to do."""
    mark = DELIMITERS.get(delimiter, repr(delimiter))
    halves = [f"{a}{delimiter}{b}" for a, b in pairwise(cells) if re.fullmatch(r"[-+]?\d+", a) and b.isdigit()]
    texts = [cell.strip() for cell in cells if cell.strip() and not is_value(cell, ".")]
    if len(cells) < width:
        return f"write {mark} for each blank cell, and remove a line that is unfinished or no row"
    if texts:
        return f'a text with {mark} in it, as near {texts[0]!r}, has to be in quotes (")'
    if halves and delimiter == ",":
        return f"a decimal comma, as in {halves[0]!r}, needs ';' or a tab between the cells: export it so"
    return "remove the cell that is too many"


def _find_first_row(rows: Rows, width: int, decimal: str) -> int | None:
    """Return the index of the first row of numbers, None if no row is one.

    All its cells are numbers, dates or empty, and one is a number at least. In columns without any value, as those of
    a state or of remarks, any text may stand; a row with such text has values in half of the others at least.
    """
    texts = [_strip_names(cells) for _, cells in rows]
    wide = [row for row in texts if len(row) >= width]
    filled = {i for row in wide for i, text in enumerate(row) if text}
    words = filled - {i for row in wide for i, text in enumerate(row) if text and is_value(text, decimal)}
    blank_first = not any(row[0] for row in texts[-LAST_ROWS:] if row)
    for at, row in enumerate(texts):
        if blank_first and row and row[0] and not is_value(row[0], decimal):  # of the header, as it begins with a name
            continue
        others = [text for i, text in enumerate(row) if i not in words]
        if len(rows[at][1]) < width or not any(is_number(text, decimal) for text in others):
            continue
        filled_enough = len(others) == len(row) or 2 * sum(map(bool, others)) >= width - len(words)
        if filled_enough and all(is_value(text, decimal) for text in others):
            return at
    return None


def _name_lines(rows: Rows, width: int, decimal: str) -> list[int]:
    """Return the indices of the last lines in a row that are as wide as the table and hold no number.

    The lowest may lack a name, so that who reads the rows can say so.
    """
    block: list[int] = []
    for at in reversed(range(len(rows))):
        names = _strip_names(_strip_mark(rows[at][1]))
        texts = [text for text in names if text]
        if any(is_number(text, decimal) or is_date(text) for text in texts):
            break
        if len(names) >= max(1, width) or (not block and len(texts) >= max(2, width - 1)):
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


def find_labelled_units(rows: Rows) -> int | None:
    """Return the index of the row of units that says so itself, None without."""
    return next((at for at, (_, cells) in enumerate(rows) if _is_labelled(cells) and _is_unit_row(cells)), None)


def strip_units(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the units in a line of them, without brackets."""
    return tuple(cell.strip().strip("[]()") for cell in _unit_cells(cells))


def _is_labelled(cells: Sequence[str]) -> bool:
    """Return whether a line says first that units follow, as Y_Unit_Label does."""
    return bool(cells) and cells[0].strip().casefold() in UNIT_LABELS


def _unit_cells(cells: Sequence[str]) -> list[str]:
    """Return the cells of a line of units, without the mark of a comment and what says that they are units."""
    return ["", *cells[1:]] if _is_labelled(cells) else _strip_mark(cells)


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether all cells are units, or marks for none."""
    texts = [cell.strip() for cell in _unit_cells(cells)]
    units = [text for text in texts if find_unit(text) is not None]
    return bool(units) and all(text in units or text.strip("[]()") in NO_UNIT | OTHER_UNITS for text in texts)
