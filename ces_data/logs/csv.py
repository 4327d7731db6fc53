"""Text tables: read once, line by line, into one array of numbers for each column."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import TextIOWrapper
from itertools import accumulate, chain, islice, repeat, zip_longest
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ces_data.logs import csv_form
from ces_data.logs.log_file import LogTable, Progress
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_data.recording import Stamps, Values
from ces_observer.errors import RecordingError

BATCH = 300  # rows converted together; their cells fit into the processor's cache
SAMPLE = 5_000  # rows that show how numbers are written
EXACT_DIGITS = 15  # a whole number of more digits is kept as text, since a float would round it
NUMBER_STARTS = frozenset("0123456789+-.")
LINE_BREAK = re.compile("\r\n|\r|\n")
EXACT_UNITS = {"ns": 1, "us": 1_000, "ms": 1_000_000}  # in nanoseconds


def open_log(path: Path, mapping: DynoMapping, progress: Progress) -> CsvTable:
    """Read a text table; raises RecordingError if it has no rows of numbers, or a quote that is not closed."""
    try:
        return CsvTable(path, mapping, progress)
    except csv.Error as error:
        raise RecordingError(f'{path}: cannot be read as a table: {error}; is a quote (") not closed?') from None


@dataclass
class _Cells:
    """A column: numbers (NaN: none), rows without one, the first bad cell; `texts` of dates and long numbers."""

    texts: list[str] | None
    numbers: array[float] = field(default_factory=lambda: array("d"))
    blanks: array[int] = field(default_factory=lambda: array("q"))
    blank: str = ""  # the first of them, as `NA`
    bad: tuple[int, str | None] | None = None  # row and text; None for a line that ends before this column


class CsvTable(LogTable):
    """A table of text cells. Memory is 8 bytes a cell, and the text of columns that hold dates."""

    def __init__(self, path: Path, mapping: DynoMapping, progress: Progress) -> None:
        self.path, self.mapping, self._progress = path, mapping, progress
        self.dialect = csv_form.find_dialect(path, mapping)
        self.names = mapping.names or self.dialect.names
        self._lines = array("q")
        self._widths = array("l")
        self._columns: list[_Cells] = []
        self._comments, self._head = 0, self.dialect.head
        self._read()
        left_out = [f"{self._comments} comment lines are left out"] if self._comments else []
        self.notes = (*self.dialect.notes, *left_out)
        if not self._lines:
            reason = f"no rows of numbers after {self.dialect.head} header lines"
            empty = "the file is empty; expected a header and rows of numbers"
            raise RecordingError(f"{path}: {reason if self.dialect.head else empty}")
        if all(cells.texts is None and np.isnan(cells.numbers).all() for cells in self._columns):
            raise RecordingError(f"{path}: no cell from line {self._lines[0]} on is a number; expected rows of numbers")

    def column(self, key: str | int) -> Values:
        """Return a column, NaN where a cell is blank; raises RecordingError naming the line of a bad cell."""
        cells, name = self._cells(key)
        if cells.bad is not None:
            raise self._bad_cell(cells.bad, name)
        if len(cells.blanks) and self.mapping.blank == "error":
            raise self._bad_cell((cells.blanks[0], cells.blank), name)
        values = np.frombuffer(cells.numbers, dtype=np.float64) if cells.numbers else np.empty(0)
        values.flags.writeable = False
        return values

    def missing(self, key: str | int) -> NDArray[np.bool_] | None:
        """Return which rows are blank in a column, None if none is."""
        cells, _ = self._cells(key)
        return np.isin(np.arange(len(self._lines)), cells.blanks) if len(cells.blanks) else None

    def stamps(self, column: LogColumn) -> Stamps | None:
        """Return the times of a column of dates or of long whole numbers of nanoseconds; None for other numbers."""
        cells, name = self._cells(column.key)
        where = f"{self.path}: column {name}"
        if cells.texts is None:
            return None
        try:
            if column.unit not in EXACT_UNITS or not cells.texts[0].isdigit():
                return csv_form.parse_dates(cells.texts, column.date)
            for row, text in enumerate(cells.texts):
                if not text.removeprefix("-").isdecimal():
                    raise ValueError(text, row)
            return np.array([int(text) * EXACT_UNITS[column.unit] for text in cells.texts], dtype=np.int64)
        except OverflowError:
            raise RecordingError(f"{where} has a time beyond the year 2262; check its unit") from None
        except csv_form.AmbiguousDateError as error:
            raise RecordingError(
                f"{where}: {str(error)!r} may be month/day or day/month; set date: "
                f"'%m/%d/%Y %H:%M:%S.%f' or '%d/%m/%Y %H:%M:%S.%f' in {self.mapping.source}"
            ) from None
        except ValueError as error:
            text, row = error.args
            expected = f"a time like the first one, {cells.texts[0]!r}" if row else "a date that exists"
            raise RecordingError(
                f"{self.path}:{self._lines[row]}: column {name} is {text!r}; expected {expected} "
                f"(or set date: in {self.mapping.source}, such as '%d/%m/%Y %H:%M:%S.%f')"
            ) from None

    def unit(self, key: str | int) -> str:
        """Return the unit in the row below the names."""
        at, units = self._index(key, self.width), self.dialect.units
        return units[at] if at < len(units) else ""

    def first(self, key: str | int) -> float:
        """Return the number in the first row; the cells below may be empty."""
        cells, name = self._cells(key)
        if np.isnan(cells.numbers[0]) and cells.bad is not None and cells.bad[0] == 0:
            raise self._bad_cell(cells.bad, name)
        return cells.numbers[0]

    def place(self, row: int) -> str:
        """Return the line in the file."""
        return f"line {self._lines[row]}"

    @property
    def width(self) -> int:
        """The number of columns, with or without a name."""
        return max(len(self.names), len(self._columns))

    def _cells(self, key: str | int) -> tuple[_Cells, str]:
        i = self._index(key, self.width)
        name = f"'{self.names[i]}'" if i < len(self.names) else str(key)
        if i >= len(self._columns):
            raise self._bad_cell((0, None), name)
        return self._columns[i], name

    def _read(self) -> None:
        """Read all rows; the first one decides which columns are text.

        Columns with thousands separators that look like decimal marks are bad, unless the mapping states those marks.
        """
        sample: list[list[str]] = []
        for rows in self._batches():
            sample += rows[: SAMPLE - len(sample)]
            for cell in map(str.strip, [] if self._columns else rows[0]):
                is_text = csv_form.is_date(cell) or (cell.isdigit() and len(cell) > EXACT_DIGITS)
                self._columns.append(_Cells([] if is_text else None))
            first = len(self._widths)
            self._widths.extend(map(len, rows))
            missing = (None,) * len(rows)
            for column, cells in zip(self._columns, chain(zip_longest(*rows), repeat(missing)), strict=False):
                self._add(column, first, cells)
        mark = self.dialect.decimal
        for column, texts in zip(self._columns, zip_longest(*sample, fillvalue=""), strict=False):
            if self.mapping.decimal is None and column.bad is None and csv_form.mixes_groups(texts, mark):
                column.bad = next((row, cell) for row, cell in enumerate(texts) if mark in cell)

    def _batches(self) -> Iterator[list[list[str]]]:
        """Yield the cells of the next rows; keeps the number of each one's last line, and reports the share read."""
        size, before = max(1, self.path.stat().st_size), 0
        with self.path.open("rb") as raw, TextIOWrapper(raw, self.dialect.encoding, "replace", newline="") as file:
            reader = csv.reader(file, delimiter=self.dialect.delimiter, skipinitialspace=True)
            while batch := list(islice(reader, BATCH)):
                lines: Sequence[int] = range(before + 1, reader.line_num + 1)
                if len(lines) > len(batch):  # there are line breaks in quoted cells
                    counts = (1 + sum(len(LINE_BREAK.findall(cell)) for cell in row) for row in batch)
                    lines = [before + n for n in accumulate(counts)]
                before = reader.line_num
                kept = [at for at, cells in enumerate(batch) if self._is_row(cells)]
                self._lines.extend(lines[at] for at in kept)
                self._progress(raw.tell() / size)
                if kept:
                    yield batch if len(kept) == len(batch) else [batch[at] for at in kept]

    def _is_row(self, cells: Sequence[str]) -> bool:
        """Return whether a line is a row: not blank, below the header, and no comment; counts the others."""
        if not self._head and cells and cells[0][:1] in NUMBER_STARTS:
            return True
        if not any(map(str.strip, cells)):
            return False
        first, in_head = cells[0].lstrip(), self._head > 0
        comment = not in_head and first.startswith(csv_form.COMMENT_MARKS) and not csv_form.is_missing(first)
        self._head -= in_head
        self._comments += comment
        return not in_head and not comment

    def _add(self, column: _Cells, row: int, cells: Sequence[str | None]) -> None:
        """Add the cells of rows from `row` on, at once if all are numbers; None stands for one that is missing."""
        mark = self.dialect.decimal
        if column.texts is None and None not in cells:
            texts = cast(Sequence[str], cells)
            joined = "\0".join(texts)
            if "_" not in joined and (mark == "." or "." not in joined):  # 1_000, and a point among decimal commas
                with suppress(ValueError):
                    numbers = map(float, texts if mark == "." else joined.replace(mark, ".").split("\0"))
                    column.numbers.extend(array("d", numbers))
                    return
        for at, cell in enumerate(cells, start=row):
            if column.texts is not None:
                column.texts.append((cell or "").strip())
            try:
                column.numbers.append(csv_form.parse_number(cell or "", mark))
                continue
            except ValueError:
                column.numbers.append(np.nan)
            if cell is not None and (not cell.strip() or csv_form.is_missing(cell)):
                column.blank = cell if not len(column.blanks) else column.blank
                column.blanks.append(at)
            elif column.bad is None:
                column.bad = (at, cell)

    def _bad_cell(self, bad: tuple[int, str | None], name: str) -> RecordingError:
        row, text = bad
        where = f"{self.path}:{self._lines[row]}: column {name}"
        if text is None:
            return RecordingError(f"{where} is missing; the line has {self._widths[row]} cells")
        expected = "a number"
        if csv_form.is_grouped(text):
            expected = "a number without thousands separators: export it so"
        elif self.dialect.decimal != "." and csv_form.is_number(text, "."):
            expected = f"decimals by '{self.dialect.decimal}' as elsewhere"
        elif not text.strip() or csv_form.is_missing(text):
            kind = "that" if text.strip() else "a blank"
            expected = f"a number (if {kind} is a missing sample, set blank: missing in {self.mapping.source})"
        return RecordingError(f"{where} is {text!r}; expected {expected}")
