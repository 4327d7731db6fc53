"""How a text table is written: delimiter, decimal mark, header and row of units, found from its first lines."""

from __future__ import annotations

import codecs
import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_identify.recordings.formats.dates import is_date
from ces_identify.recordings.log_mapping import DynoMapping
from ces_identify.recordings.units import find_unit
from ces_observer.errors import RecordingError

SAMPLE_LINES, SAMPLE_BYTES = 200, 65_536
DELIMITERS = {"\t": "a tab", ";": "';'", "|": "'|'", ",": "','", " ": "a blank"}
NO_UNIT = frozenset({"", "-", "--", "1", "[-]", "(-)", "%", "[]"})
Rows = list[tuple[int, list[str]]]  # number and cells of each line that is not blank


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
    head = _count_head(rows, mapping.header_lines, decimal)
    units = _find_units(rows, head, decimal)
    above = head - 1 - bool(units)
    names = strip_names(rows[above][1]) if 0 <= above < len(rows) else ()
    return CsvDialect(
        encoding, delimiter, decimal, head, names, units, tuple(_notes(mapping, delimiter, decimal, units))
    )


def find_encoding(path: Path) -> str:
    """Return the encoding of a text file: UTF-8, UTF-16 with its mark, or else Windows' Western one.

    Raises RecordingError if the file is not text.
    """
    with path.open("rb") as file:
        head = file.read(SAMPLE_BYTES)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if b"\0" in head:
        raise RecordingError(f"{path}: not a text table, but binary data; set format in the mapping if it has another")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def parse_lines(lines: Sequence[str], delimiter: str) -> Rows:
    """Return number and cells of each line that is not blank."""
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    return [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]


def strip_names(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the names in a header line, without the empty ones after trailing delimiters."""
    names = [cell.strip() for cell in cells]
    while names and not names[-1]:
        names.pop()
    return tuple(names)


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _fit(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[float, float]:
    """Return how well a form suits the last lines: cells that are numbers, in rows of one width; then fewer cells."""
    rows = [cells for _, cells in parse_lines(lines, delimiter)][-20:]
    widths = Counter(map(len, rows))
    if not widths:
        return 0.0, 0.0
    width, count = widths.most_common(1)[0]
    cells = [cell for row in rows if len(row) == width for cell in row if cell.strip()]
    good = sum(is_number(cell, decimal) or is_date(cell) for cell in cells)
    share = good / max(len(cells), 1) * count / len(rows)
    return (share if width > 1 else 0.5 * share), -width


def _count_head(rows: Rows, stated: int | None, decimal: str) -> int:
    """Return the number of rows before the first one of numbers."""
    if stated is not None:
        return sum(number <= stated for number, _ in rows)
    if not rows or _is_data(rows[0][1], decimal):
        return 0
    width = Counter(len(strip_names(cells)) for _, cells in rows[-20:]).most_common(1)[0][0]
    at = next((i for i, (_, cells) in enumerate(rows) if _is_name_row(cells, width, decimal)), 0)
    return at + 1 + bool(at + 1 < len(rows) and _is_unit_row(rows[at + 1][1], decimal))


def _is_name_row(cells: Sequence[str], width: int, decimal: str) -> bool:
    names = strip_names(cells)
    return len(names) >= max(1, width) and not any(is_number(cell, decimal) for cell in names)


def _is_data(cells: Sequence[str], decimal: str) -> bool:
    return all(is_number(cell, decimal) or is_date(cell) for cell in strip_names(cells))


def _is_unit_row(cells: Sequence[str], decimal: str) -> bool:
    texts = [cell.strip() for cell in cells]
    known = sum(find_unit(text) is not None for text in texts)
    others = [text for text in texts if find_unit(text) is None and text not in NO_UNIT]
    return known > 0 and not others and not any(is_number(text, decimal) for text in texts if text != "1")


def _find_units(rows: Rows, head: int, decimal: str) -> tuple[str, ...]:
    """Return the cells of the last header row if it holds units, below the row of names."""
    if head < 2 or head > len(rows) or not _is_unit_row(rows[head - 1][1], decimal):
        return ()
    return tuple(cell.strip().strip("[]()") for cell in rows[head - 1][1])


def _notes(mapping: DynoMapping, delimiter: str, decimal: str, units: Sequence[str]) -> list[str]:
    """Return what was found and is not what a CSV file has by default."""
    found = []
    if mapping.delimiter is None and delimiter != ",":
        found.append(f"cells are separated by {DELIMITERS[delimiter]}")
    if mapping.decimal is None and decimal != ".":
        found.append("decimals by ','")
    if units:
        found.append(f"units in the second header line ({', '.join(unit or '-' for unit in units)})")
    return found
