"""How a text table is written: delimiter, decimal mark, header and row of units, found from its first lines."""

from __future__ import annotations

import codecs
import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_identify.recordings.formats.csv_cells import is_missing, is_number
from ces_identify.recordings.formats.csv_header import Rows, find_header
from ces_identify.recordings.formats.dates import is_date
from ces_identify.recordings.log_mapping import DynoMapping
from ces_observer.errors import RecordingError

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
