"""The lines before the first row of numbers in a text table: which one names the columns, which holds their units."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_data.logs.csv_cells import COMMENT_MARKS, is_date, is_missing, is_number, is_value
from ces_data.logs.log_mapping import DynoMapping
from ces_data.units import find_unit
from ces_observer.errors import RecordingError

NO_UNIT = frozenset({"", "-", "--", "1", "[-]", "(-)", "%", "[]"})
LINE_BREAK = re.compile(r"\s*[\r\n\t]\s*")  # in a quoted cell
LAST_ROWS = 20  # which say how wide the table is
Rows = list[tuple[int, list[str]]]  # number and cells of each line that is not blank


@dataclass(frozen=True)
class CsvHeader:
    """`head` counts the lines that are not blank before the first row; `names` and `units` may be empty."""

    head: int
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


def find_header(rows: Rows, stated: int | None, decimal: str) -> CsvHeader:
    """Return the header among the first rows of a table; `stated` is the number of its lines, if that is known.

    The names are in the first line as wide as the table among those that stand directly above the numbers; lines of
    units and of one cell may stand between them.
    """
    first = _count_stated(rows, stated) if stated is not None else _find_first_row(rows, decimal)
    if first == 0 or not rows:
        return CsvHeader(0)
    width = _width(rows)
    block = _name_lines(rows[: len(rows) if first is None else first], width, decimal)
    names_at = next((at for at in block if not is_unit_row(rows[at][1])), None)
    units_at = next((at for at in block if is_unit_row(rows[at][1])), None)
    if names_at is None:
        return CsvHeader(1 if first is None else first)
    if stated is None:
        first = _skip_header_text(rows, max(names_at, -1 if units_at is None else units_at) + 1, first, decimal)
    above = [strip_mark(rows[at][1]) for at in range(names_at, first or len(rows)) if at not in block or at == names_at]
    units = rows[units_at][1] if units_at is not None else []
    below = [rows[at][1] for at in block if at > names_at and not is_unit_row(rows[at][1])]
    return CsvHeader(
        names_at + 1 if first is None else first,
        _add_groups(_fill_blanks(above[0], above[1:]), below),
        tuple(cell.strip().strip("[]()") for cell in strip_mark(units)),
    )


def strip_names(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the names in a header line, without the empty ones after trailing delimiters."""
    names = [LINE_BREAK.sub(" ", cell.strip()) for cell in cells]
    while names and not names[-1]:
        names.pop()
    return tuple(names)


def strip_mark(cells: Sequence[str]) -> list[str]:
    """Return the cells of a line without the mark of a comment at its beginning."""
    first = cells[0].strip() if cells else ""
    mark = next((mark for mark in COMMENT_MARKS if first.startswith(mark)), "")
    rest = first[len(mark) :].strip()
    return list(cells) if not mark else [rest, *cells[1:]] if rest else list(cells[1:])


def is_data_row(cells: Sequence[str], decimal: str, width: int, words: Collection[int]) -> bool:
    """Return whether a line is a row of numbers: all cells are numbers, dates or empty, and one is a number at least.

    In the columns `words` any text may stand; a row with such text has values in half of the other columns at least.
    """
    texts = strip_names(cells)
    others = [text for i, text in enumerate(texts) if i not in words]
    numbers = sum(is_number(text, decimal) for text in others)
    if not numbers or not all(is_value(text, decimal) for text in others):
        return False
    return len(others) == len(texts) or 2 * sum(map(bool, others)) >= width - len(words)


def is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether all cells are units, or marks for none."""
    texts = [cell.strip() for cell in strip_mark(cells)]
    known = sum(find_unit(text) is not None for text in texts)
    return known > 0 and all(find_unit(text) is not None or text in NO_UNIT for text in texts)


def _count_stated(rows: Rows, stated: int) -> int:
    return sum(number <= stated for number, _ in rows)


def _find_first_row(rows: Rows, decimal: str) -> int | None:
    """Return the index of the first row of numbers, None if no row is one."""
    width = _width(rows)
    words = _word_columns(rows, width, decimal)
    rows_of_numbers = [at for at, (_, cells) in enumerate(rows) if is_data_row(cells, decimal, width, words)]
    wide = (at for at in rows_of_numbers if len(rows[at][1]) >= width)
    return next(wide, None)


def _word_columns(rows: Rows, width: int, decimal: str) -> frozenset[int]:
    """Return the columns without any value, as those of a state or of remarks."""
    wide = [texts for _, cells in rows if len(texts := strip_names(cells)) >= width]
    filled = {i for texts in wide for i, text in enumerate(texts) if text}
    return frozenset(filled - {i for texts in wide for i, text in enumerate(texts) if text and is_value(text, decimal)})


def _width(rows: Rows) -> int:
    widths = Counter(len(strip_names(cells)) for _, cells in rows[-LAST_ROWS:])
    return widths.most_common(1)[0][0] if widths else 0


def _name_lines(rows: Rows, width: int, decimal: str) -> list[int]:
    """Return the indices of the last lines in a row that are as wide as the table and hold no number."""
    found: list[int] = []
    for at in reversed(range(len(rows))):
        cells = strip_mark(rows[at][1])
        texts = [text for text in strip_names(cells) if text]
        if any(is_number(text, decimal) or is_date(text) for text in texts):
            break
        if len(strip_names(cells)) >= max(1, width):
            found.append(at)
        elif len(texts) > 1:
            break
    return found[::-1]


def _skip_header_text(rows: Rows, start: int, first: int | None, decimal: str) -> int | None:
    """Return where the rows begin: at the first line below the header that holds a number, though others be bad."""
    for at in range(start, first or start):
        if any(is_number(cell, decimal) for cell in rows[at][1]):
            return at
    return first


def _add_groups(names: tuple[str, ...], below: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names; where several columns share one, it is that of a group, before the name in the next line."""
    if len(set(names)) == len(names) or not below:
        return names
    joined = tuple(" ".join(pair).strip() for pair in zip(names, strip_names(below[0]), strict=False))
    return joined if len(set(joined)) == len(names) else names


def _fill_blanks(names: Sequence[str], others: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names, the empty ones from lines of one cell below (a table's index is named there by pandas)."""
    filled = list(strip_names(names))
    for other in others:
        for i, cell in enumerate(other[: len(filled)]):
            filled[i] = filled[i] or cell.strip()
    return tuple(filled)


SAMPLE_LINES, SAMPLE_BYTES = 200, 65_536
DELIMITERS = {"\t": "a tab", ";": "';'", "|": "'|'", ",": "','", " ": "a blank"}


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
    encoding = find_encoding(path)
    with path.open(encoding=encoding, errors="replace", newline="") as file:
        lines = [line for _, line in zip(range(SAMPLE_LINES), file, strict=False)]
    delimiters = [mapping.delimiter] if mapping.delimiter else list(DELIMITERS)
    decimals = [mapping.decimal] if mapping.decimal else [".", ","]
    choices = [(d, p) for d in delimiters for p in decimals if d != p]
    delimiter, decimal = max(choices, key=lambda choice: _fit(lines, *choice)) if len(choices) > 1 else choices[0]
    rows = parse_lines(lines, delimiter)
    header = find_header(rows, mapping.header_lines, decimal)
    notes = tuple(_notes(mapping, delimiter, decimal, header.units))
    return CsvDialect(encoding, delimiter, decimal, header.head, header.names, header.units, notes)


def find_encoding(path: Path) -> str:
    """Return the encoding of a text file: UTF-8, UTF-16, or else Windows' Western one.

    Raises RecordingError if the file is not text.
    """
    with path.open("rb") as file:
        head = file.read(SAMPLE_BYTES)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if wide := _find_utf16(head):
        return wide
    if b"\0" in head:
        raise RecordingError(f"{path}: not a text table, but binary data; set format in the mapping if it has another")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _find_utf16(head: bytes) -> str:
    """Return the UTF-16 encoding of a text without mark, '' for any other: every second byte is zero."""
    for name, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
        if head and zeros.count(0) > 0.9 * len(zeros) and head.count(0) < 1.1 * len(zeros):
            return name
    return ""


def parse_lines(lines: Sequence[str], delimiter: str) -> Rows:
    """Return number and cells of each line that is not blank."""
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]


def _fit(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[float, float]:
    """Return how well a form suits the last lines: cells that are numbers, in rows of one width; then fewer cells."""
    rows = [cells for _, cells in parse_lines(lines, delimiter)][-20:]
    widths = Counter(map(len, rows))
    if not widths:
        return 0.0, 0.0
    width, count = widths.most_common(1)[0]
    cells = [cell for row in rows if len(row) == width for cell in row if cell.strip()]
    good = sum(is_number(cell, decimal) or is_date(cell) or is_missing(cell) for cell in cells)
    share = good / max(len(cells), 1) * count / len(rows)
    return (share if width > 1 else 0.5 * share), -width


def _notes(mapping: DynoMapping, delimiter: str, decimal: str, units: Sequence[str]) -> list[str]:
    """Return what was found and is not what a CSV file has by default."""
    found = []
    if mapping.delimiter is None and delimiter != ",":
        found.append(f"cells are separated by {DELIMITERS[delimiter]}")
    if mapping.decimal is None and decimal != ".":
        found.append("decimals by ','")
    if units:
        found.append(f"units in the header ({', '.join(unit or '-' for unit in units)})")
    return found
