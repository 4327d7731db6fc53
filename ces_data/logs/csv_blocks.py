"""Blocks of rows in a text table, each below a header of its own, as controllers of test benches write a test.

The names of the first header are looked for in the rest of the file; where they come again, a block begins. Its
columns may be in another order and in other units: they are read as those of the first block.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ces_data.logs.csv_cells import is_number, is_value
from ces_data.logs.csv_form import CsvDialect, find_header, find_labelled_units, parse_lines, strip_units
from ces_data.recording import Values
from ces_data.units import find_unit
from ces_observer.errors import RecordingError

MAX_TITLES = 4  # of blocks, that are printed
MAX_HEADER = 200  # lines between two blocks
Rows: TypeAlias = "Values | list[list[str]]"  # numbers (n, columns), or the cells of each row


@dataclass(frozen=True)
class RowBlock:
    """The rows from byte `begin` to `end` of a file, above which `line` lines stand; `title` is from its header.

    `order` holds the place of each column of the first block, if it is another one; `factors` those of other units.
    `repeated` says that the names alone came again, as where a logger was opened again.
    """

    begin: int
    end: int
    line: int
    title: str = ""
    order: tuple[int, ...] = ()
    factors: Mapping[int, float] = field(default_factory=dict)
    repeated: bool = False

    def reorder(self, rows: Rows) -> Rows:
        """Return rows with their cells in the order of the first block."""
        if not self.order:
            return rows
        if isinstance(rows, np.ndarray):
            return rows[:, list(self.order)]
        return [[cells[i] for i in self.order if i < len(cells)] for cells in rows]


@dataclass(frozen=True)
class _Header:
    """A header: the byte and the line (from 1) where it begins, the byte of its names, and the lines above these."""

    begin: int
    line: int
    names: int
    above: tuple[str, ...]


def find_blocks(path: Path, dialect: CsvDialect) -> tuple[RowBlock, ...]:
    """Return the blocks of a table whose header comes again, none for one block; raises RecordingError if they differ.

    A block with other columns than the first one is refused.
    """
    first = dialect.names_line
    if not first or dialect.encoding.startswith("utf-16"):
        return ()
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begin = _skip_lines(content, 0, first - 1)
        places = list(_find_names(content, begin, dialect))
        if not places:
            return ()
        headers = _read_headers(content, (begin, *places), dialect)
        ends = [*(header.begin for header in headers[1:]), len(content)]
        titles = _find_titles(headers)
        blocks = [_make_block(content, *of, path, dialect) for of in zip(headers, ends, titles, strict=True)]
    return tuple(block for block in blocks if block.begin < block.end)


def select_block(blocks: Sequence[RowBlock], rows: str, path: Path) -> tuple[RowBlock, ...]:
    """Return the one block that `rows` names, as `block(2)`; raises RecordingError if there is none."""
    number = re.fullmatch(r"block\((\d+)\)", rows)
    if number is None or not 1 <= int(number[1]) <= len(blocks):
        has = f"block(1) to block({len(blocks)})" if blocks else "no rows: the table has one block"
        raise RecordingError(f"{path}: rows is '{rows}'; expected {has}")
    return (blocks[int(number[1]) - 1],)


def describe_blocks(blocks: Sequence[RowBlock]) -> str:
    """Return how many blocks are read, and their titles."""
    if len(blocks) == 1:
        return f"the block from line {blocks[0].line + 1} on, '{blocks[0].title}', alone"
    shown = [f"line {b.line + 1}" + (f" '{b.title}'" if b.title else "") for b in blocks[:MAX_TITLES]]
    more = [f"{len(blocks) - MAX_TITLES} more"] if len(blocks) > MAX_TITLES else []
    gaps = "gaps where the time does not go on" if all(b.repeated for b in blocks[1:]) else "gaps between them"
    text = f"{len(blocks)} blocks of rows with a header each, read as one recording with {gaps}"
    return f"{text} ({', '.join([*shown, *more])}; 'rows: block(2)' in a mapping takes one)"


def _find_names(content: mmap.mmap, begin: int, dialect: CsvDialect) -> Iterator[int]:
    """Yield where lines begin as the names of the columns do, after the first."""
    line = content[begin : _end_of_line(content, begin)].rstrip(b"\r\n")
    delimiter = dialect.delimiter.encode()
    stripped = line.lstrip()
    key = line[: len(line) - len(stripped)] + stripped.partition(delimiter)[0] + delimiter if stripped else line
    key = b"\n" + (key if stripped[:1] not in (delimiter, b"") and delimiter in stripped else line)
    place = begin
    while (place := content.find(key, place)) >= 0:
        place += 1
        text = _decode(content[place : _end_of_line(content, place)], dialect)
        if not any(
            is_number(cell, dialect.decimal) for _, cells in parse_lines([text], dialect.delimiter) for cell in cells
        ):
            yield place


def _read_headers(content: mmap.mmap, places: Sequence[int], dialect: CsvDialect) -> list[_Header]:
    """Return the headers whose names are at these bytes: above them all lines that are no rows."""
    headers, last, line = [], 0, 1
    for names in places:
        begin, above = names, list[str]()
        while begin and len(above) < MAX_HEADER:
            before = content.rfind(b"\n", 0, begin - 1) + 1
            text = _decode(content[before:begin], dialect)
            if _is_row(text, dialect):
                break
            begin = before
            above.insert(0, text)
        line, last = line + content[last:begin].count(b"\n"), begin
        headers.append(_Header(begin, line, names, tuple(above)))
    return headers


def _is_row(line: str, dialect: CsvDialect) -> bool:
    """Return whether a line has values in half of the columns at least, and one in the first."""
    rows = parse_lines([line], dialect.delimiter)
    cells = [cell.strip() for cell in rows[0][1]] if rows else [""]
    filled = [cell for cell in cells if cell]
    values = sum(is_value(cell, dialect.decimal) for cell in filled)
    return bool(cells[0]) and is_value(cells[0], dialect.decimal) and 2 * values >= len(dialect.names)


def _find_titles(headers: Sequence[_Header]) -> list[str]:
    """Return the text of the line above the names in which the headers differ, the lowest one."""
    texts = [[" ".join(line.split()) for line in header.above[::-1]] for header in headers]
    for column in zip_longest(*texts, fillvalue=""):
        if len(set(column)) == len(column) or (len(set(column)) > 1 and all(column)):
            return list(column)
    return [""] * len(headers)


def _make_block(content: mmap.mmap, header: _Header, end: int, title: str, path: Path, dialect: CsvDialect) -> RowBlock:
    lines, place = list[str](), header.names
    while place < end and len(lines) < MAX_HEADER:
        lines.append(_decode(content[place : (place := _end_of_line(content, place))], dialect))
    rows = parse_lines(lines, dialect.delimiter)
    head, names, units, _ = find_header(rows, None, dialect.decimal)
    stated = parse_lines(header.above, dialect.delimiter)
    if not units and (labelled := find_labelled_units(stated)) is not None:
        units = strip_units(stated[labelled][1])
    above = rows[head][0] - 1 if head < len(rows) else len(lines)  # lines from the names to the first row
    at = header.line + len(header.above)
    begin, line, where = _skip_lines(content, header.names, above), at + above - 1, f"{path}:{at}"
    if sorted(names) != sorted(dialect.names) or (names != dialect.names and len(set(names)) < len(names)):
        has = f"the header of a block names {', '.join(names)}, that of line {dialect.names_line}"
        raise RecordingError(f"{where}: {has} {', '.join(dialect.names)}; cut the file before it and import each part")
    order = tuple(map(names.index, dialect.names)) if names != dialect.names else ()
    factors = _find_factors(dialect, [units[i] for i in order] if order and units else units, where)
    return RowBlock(begin, max(begin, end), line, title, order, factors, not any(map(str.strip, header.above)))


def _find_factors(dialect: CsvDialect, units: Sequence[str], where: str) -> dict[int, float]:
    """Return the factors to the first block's units, by column."""
    factors = {}
    for at, (mine, first) in enumerate(zip_longest(units, dialect.units, fillvalue="")):
        if mine == first:
            continue
        unit, wanted = find_unit(mine), find_unit(first)
        if unit is None or wanted is None or (unit.quantity, unit.offset) != (wanted.quantity, wanted.offset):
            text = f"column '{dialect.names[at]}' is in '{mine}', in the first block in '{first}'"
            raise RecordingError(f"{where}: {text}; cut the file before this block and import each part")
        factors[at] = unit.scale / wanted.scale
    return factors


def _decode(line: bytes, dialect: CsvDialect) -> str:
    return line.decode(dialect.encoding, "replace")


def _end_of_line(content: mmap.mmap, begin: int) -> int:
    end = content.find(b"\n", begin)
    return len(content) if end < 0 else end + 1


def _skip_lines(content: mmap.mmap, begin: int, count: int) -> int:
    for _ in range(count):
        begin = _end_of_line(content, begin)
    return begin
