"""Text tables, in blocks of rows with one array of numbers for each column.

Lines of numbers alone are converted many at once, all others cell by cell as Python's csv module finds them.
"""

from __future__ import annotations

import csv
import re
import warnings
from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass, field
from io import SEEK_CUR, BytesIO, TextIOWrapper
from itertools import accumulate, chain, islice, repeat, zip_longest
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from ces_data.logs import csv_cells, csv_form
from ces_data.logs.csv_blocks import RowBlock, Rows, describe_blocks, find_blocks, select_block
from ces_data.logs.log_file import MAX_CELLS, MAX_ROWS, LogTable, Progress
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_data.recording import Stamps, Values
from ces_observer.errors import RecordingError

BATCH = 300  # rows converted together; their cells fit into the processor's cache
SAMPLE = 5_000  # rows that show how numbers are written
FIRST_PART, PART, MAX_LINE = 1 << 16, 1 << 22, 1 << 20  # bytes read together in the sample and after it
EXACT_DIGITS = 15  # a whole number of more digits is kept as text, since a float would round it
NUMBER_STARTS = frozenset("0123456789+-.")
PLAIN = b"0123456789+-eE\n"  # bytes of numbers alone, with the marks of decimals and cells
DATED = re.compile(r"\d[-./: T]+\d+[-./: T]+\d")
LINE_BREAK = re.compile("\r\n|\r|\n")
EXACT_UNITS = {"ns": 1, "us": 1_000, "ms": 1_000_000}  # in nanoseconds


def open_log(path: Path, mapping: DynoMapping, progress: Progress) -> CsvTable:
    """Read a text table; raises RecordingError if it has no rows of numbers, or a quote that is not closed."""
    with _readable(path):
        return CsvTable(path, mapping, progress)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except csv.Error as error:
        raise RecordingError(f'{path}: cannot be read as a table: {error}; is a quote (") not closed?') from None


@dataclass
class _CellRows:
    """A column: numbers (NaN: none), rows without one, the first bad cell; `texts` of dates and long numbers."""

    texts: list[str] | None
    numbers: array[float] = field(default_factory=lambda: array("d"))
    blanks: array[int] = field(default_factory=lambda: array("q"))
    blank: str = ""  # the first of them, as `NA`
    bad: tuple[int, str | None] | None = None  # row and text; None for a line that ends before this column


class CsvTable(LogTable):
    """The first block of a table's rows. Memory is 8 bytes a cell, and the text of columns that hold dates."""

    def __init__(self, path: Path, mapping: DynoMapping, progress: Progress) -> None:
        self.path, self.mapping, self._progress = path, mapping, progress
        self.dialect = csv_form.find_dialect(path, mapping)
        self.names, self.notes = mapping.names or self.dialect.names, self.dialect.notes
        self.stated_Hz = self.dialect.stated_Hz
        self._comments, self._head, self._line = 0, self.dialect.head, 0
        self._row_blocks = find_blocks(path, self.dialect)
        if mapping.rows:
            self.rows, self._row_blocks = mapping.rows, select_block(self._row_blocks, mapping.rows, path)
        if self._row_blocks:
            self.notes, self._head = (*self.notes, describe_blocks(self._row_blocks)), 0
        self._notes = self.notes
        self._row_block: RowBlock | None = None
        self._width = 0  # cells of a row; of the first ones, until they are read
        self._source: Iterator[tuple[Stamps, Rows, RowBlock | None]] | None = self._read_file()
        self._begin_block([])
        sample = self._read_block(self._source)
        for column, texts in zip(self._columns, zip_longest(*sample, fillvalue=""), strict=False):
            if mapping.decimal is None and column.bad is None and csv_cells.mixes_groups(texts, self.dialect.decimal):
                column.bad = next((row, cell) for row, cell in enumerate(texts) if self.dialect.decimal in cell)
        if not self._lines:
            reason = f"no rows of numbers after {self.dialect.head} header lines"
            empty = "the file is empty; expected a header and rows of numbers"
            raise RecordingError(f"{path}: {reason if self.dialect.head else empty}")
        if all(np.isnan(cells.numbers).all() for cells in self._columns):
            bad = next((f", as '{c.bad[1]}' is none" for c in self._columns if c.texts is None and c.bad), "")
            text = f"no cell from line {self._lines[0]} on is a number{bad}; expected rows of numbers"
            raise RecordingError(f"{path}: {text}")

    def blocks(self, columns: Sequence[LogColumn]) -> Iterator[CsvTable]:
        """Yield the table in blocks of rows; the first is this one."""
        source, self._source = self._source, None
        if source is None:  # read to its end before
            with _readable(self.path):
                yield from CsvTable(self.path, self.mapping, self._progress).blocks(columns)
            return
        block = self
        while block._lines:
            yield block
            block = copy(block)
            block._begin_block(block._columns)
            with _readable(self.path):
                block._read_block(source)

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
                return self._parse_dates(self._index(column.key, self.width), cells.texts, column.date)
            for row, text in enumerate(cells.texts):
                if not text.removeprefix("-").isdecimal():
                    raise ValueError(text, row)
            return np.array([int(text) * EXACT_UNITS[column.unit] for text in cells.texts], dtype=np.int64)
        except OverflowError:
            text = "has a time beyond the year 2262; check its unit"
            dated = f"if it is a date without marks, give date: '%Y%m%d%H%M%S%f' in {self.mapping.source}"
            raise RecordingError(f"{where} {text} ({dated})") from None
        except csv_cells.AmbiguousDateError as error:
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

    def _cells(self, key: str | int) -> tuple[_CellRows, str]:
        i = self._index(key, self.width)
        name = f"'{self.names[i]}'" if i < len(self.names) else str(key)
        if i >= len(self._columns):
            raise self._bad_cell((0, None), name)
        return self._columns[i], name

    def _parse_dates(self, at: int, texts: list[str], pattern: str) -> Stamps:
        """Return the times of the block, whose form and days go on from the block before."""
        before, last_ns = self._dates_before.get(at, ([], 0))
        stamps = csv_cells.parse_dates([*before, *texts], pattern, len(before))
        if before:
            stamps = stamps[len(before) :] + (last_ns - stamps[len(before) - 1])
        self._dates[at] = [(before or texts)[0], texts[-1]], int(stamps[-1])
        return stamps

    def _begin_block(self, columns: Sequence[_CellRows]) -> None:
        """Begin a block without rows; the columns of the block before say which are text."""
        self._lines = array("q")
        self.breaks: dict[int, bool] = {}
        self._columns = [_CellRows(None if cells.texts is None else []) for cells in columns]
        self._dates_before = self._dates if columns else {}
        self._dates: dict[int, tuple[list[str], int]] = {}  # by column: the first text of all and the last, its stamp

    def _read_block(self, source: Iterator[tuple[Stamps, Rows, RowBlock | None]]) -> list[list[str]]:
        """Read rows until the block is full; the first one decides which columns are text. Return a sample of cells."""
        sample: list[list[str]] = []
        for lines, rows, row_block in source:
            first = len(self._lines)
            if row_block is not self._row_block and self._row_block is not None:
                self.breaks[first] = row_block is not None and row_block.repeated
            self._row_block = row_block
            self._lines.frombytes(lines.tobytes())
            if isinstance(rows, np.ndarray):
                for column, numbers in zip(self._columns, rows.T, strict=True):
                    column.numbers.frombytes(numbers.tobytes())
            else:
                self._require_width(lines, rows)
                sample += rows[: SAMPLE - len(sample)]
                for at, cell in enumerate(map(str.strip, [] if self._columns else rows[0])):
                    is_text = (
                        self._is_dated(at) or csv_cells.is_date(cell) or (cell.isdigit() and len(cell) > EXACT_DIGITS)
                    )
                    self._columns.append(_CellRows([] if is_text else None))
                missing = (None,) * len(rows)
                for column, cells in zip(self._columns, chain(zip_longest(*rows), repeat(missing)), strict=False):
                    self._add(column, first, cells)
            for at, factor in row_block.factors.items() if row_block else ():
                numbers = self._columns[at].numbers
                numbers[first:] = array("d", (factor * number for number in numbers[first:]))
            if len(self._lines) >= min(MAX_ROWS, MAX_CELLS // max(1, len(self._columns))):
                break
        return sample

    def _require_width(self, lines: Stamps, rows: Sequence[list[str]]) -> None:
        """Raise RecordingError for a row with more or fewer cells than the table: it is not known which is whose.

        Names of remarks at the end need no cell, and empty cells at the end no name.
        """
        usual = Counter(map(len, rows)).most_common(1)[0][0]
        if not self._width:
            numbered = self.mapping.signals and all(isinstance(c.key, int) for c in self.mapping.list_columns())
            self._width = usual if numbered or self.mapping.names else len(self.names) or usual
        width, names = self._width, self.names
        if usual != width and len(names) == width:
            while width > usual and names[width - 1].casefold() in csv_form.REMARKS:
                width -= 1
        for line, cells in zip(lines.tolist(), rows, strict=True):
            if width <= len(cells) <= self._width or (len(cells) > width and not any(map(str.strip, cells[width:]))):
                continue
            if len(cells) == usual and width == len(self.dialect.names) and line == self._lines[0]:
                has = f"line {self.dialect.names_line} has {width} names, the rows have {usual} cells"
                remedy = 'put a name with a delimiter in it in quotes ("), or give names: in a mapping, one a cell'
                raise RecordingError(f"{self.path}: {has}: which is whose is not known; {remedy}")
            has = f"the line has {len(cells)} cells, others have {width}"
            raise RecordingError(
                f"{self.path}:{line}: {has}; {csv_form.explain_width(cells, width, self.dialect.delimiter)}"
            )

    def _is_dated(self, at: int) -> bool:
        """Return whether the mapping gives the pattern of a date for a column."""
        time = self.mapping.time
        return (
            bool(time) and time is not None and bool(time.date) and self._index(time.key, max(self.width, at + 1)) == at
        )

    def _read_file(self) -> Iterator[tuple[Stamps, Rows, RowBlock | None]]:
        """Yield the lines and cells of the next rows, and their block if there are several; reports the share."""
        size = max(1, self.path.stat().st_size)
        with self.path.open("rb") as file:
            for block in self._row_blocks or (None,):
                file.seek(block.begin if block else 0)
                self._line = block.line if block else 0
                for lines, rows in self._read_rows(file, block.end if block else size, size):
                    yield lines, block.reorder(rows) if block else rows, block

    def _read_rows(self, file: BinaryIO, end: int, size: int) -> Iterator[tuple[Stamps, Rows]]:
        """Yield the same up to byte `end`, as numbers where nothing else is in them."""
        while part := file.read(min(PART if len(self._lines) >= SAMPLE else FIRST_PART, end - file.tell())):
            part += file.readline(MAX_LINE) if file.tell() < end else b""
            self._progress(file.tell() / size)
            numbers = self._parse_plain(part)
            if numbers is not None:
                begin, self._line = self._line + 1, self._line + len(numbers)
                yield np.arange(begin, self._line + 1), numbers
                continue
            whole = part.endswith(b"\n") and b'"' not in part and not self.dialect.encoding.startswith("utf-16")
            if not whole:  # a cell may go on in the next part
                file.seek(-len(part), SEEK_CUR)
            rest = BytesIO(part) if whole else file if end == size else BytesIO(file.read(end - file.tell()))
            for rows in self._split_cells(rest):
                yield rows
                self._progress(file.tell() / size)

    def _parse_plain(self, part: bytes) -> Values | None:
        """Return the numbers (n, columns) in lines after the sample, None if anything else may be in them.

        numpy and float read the same doubles.
        """
        mark, between, width = self.dialect.decimal, self.dialect.delimiter, len(self._columns)
        if len(self._lines) < SAMPLE or between in (" ", mark) or any(c.texts is not None for c in self._columns):
            return None
        part = part.replace(b"\r\n", b"\n").replace(f"{between} ".encode(), between.encode())
        if part.translate(None, PLAIN + f"{mark}{between}".encode()):
            return None
        part = part.replace(mark.encode(), b".").replace(between.encode(), b",")
        ends = np.frombuffer(part, dtype=np.uint8)
        ends = ends[(ends == ord(",")) | (ends == ord("\n"))]
        if len(ends) % width or not np.array_equal(ends == ord("\n"), np.arange(1, len(ends) + 1) % width == 0):
            return None
        with warnings.catch_warnings(), suppress(ValueError, DeprecationWarning):  # of cells that are no numbers
            warnings.simplefilter("error", DeprecationWarning)
            numbers = np.fromstring(part.replace(b"\n", b","), sep=",")
            return numbers.reshape(-1, width) if len(numbers) == len(ends) else None
        return None

    def _split_cells(self, file: BinaryIO) -> Iterator[tuple[Stamps, list[list[str]]]]:
        """Yield the lines and cells of the next rows, as the csv module finds them to the end of the file."""
        before = self._line
        text = TextIOWrapper(file, self.dialect.encoding, "replace", newline="")
        reader = csv.reader(text, delimiter=self.dialect.delimiter, skipinitialspace=True)
        while batch := list(islice(reader, BATCH)):
            lines: Sequence[int] = range(self._line + 1, before + reader.line_num + 1)
            if len(lines) > len(batch):  # there are line breaks in quoted cells
                counts = (1 + sum(len(LINE_BREAK.findall(cell)) for cell in row) for row in batch)
                lines = [self._line + n for n in accumulate(counts)]
            self._line = before + reader.line_num
            kept = [at for at, cells in enumerate(batch) if self._is_row(cells)]
            if self._comments:
                self.notes = (*self._notes, f"{self._comments} comment lines are left out")
            if kept:
                yield np.array([lines[at] for at in kept]), [batch[at] for at in kept]
        text.detach()

    def _is_row(self, cells: Sequence[str]) -> bool:
        """Return whether a line is a row: not blank, below the header, and no comment; counts the others."""
        if not self._head and cells and cells[0][:1] in NUMBER_STARTS:
            return True
        if not any(map(str.strip, cells)):
            return False
        first, in_head = cells[0].lstrip(), self._head > 0
        comment = not in_head and first.startswith(csv_form.COMMENT_MARKS) and not csv_cells.is_missing(first)
        self._head -= in_head
        self._comments += comment
        return not in_head and not comment

    def _add(self, column: _CellRows, row: int, cells: Sequence[str | None]) -> None:
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
                column.numbers.append(csv_cells.parse_number(cell or "", mark))
                continue
            except ValueError:
                column.numbers.append(np.nan)
            if cell is not None and (not cell.strip() or csv_cells.is_missing(cell)):
                column.blank = cell if not len(column.blanks) else column.blank
                column.blanks.append(at)
            elif column.bad is None:
                column.bad = (at, cell)

    def _bad_cell(self, bad: tuple[int, str | None], name: str) -> RecordingError:
        row, text = bad
        where = f"{self.path}:{self._lines[row]}: column {name}"
        if text is None:
            return RecordingError(f"{where} is missing; expected a cell in each line")
        expected, other = "a number", "," if self.dialect.decimal == "." else "."
        if csv_cells.is_grouped(text):
            expected = "a number without thousands separators: export it so"
        elif csv_cells.is_number(text, other):
            expected = f"decimals by '{self.dialect.decimal}' as elsewhere"
        elif DATED.search(text):
            expected = "a number, or a date in a known form (a mapping gives another: date: '%Y-%jT%H:%M:%S.%f')"
        elif not text.strip() or csv_cells.is_missing(text):
            kind = "that" if text.strip() else "a blank"
            expected = f"a number (if {kind} is a missing sample, set blank: missing in {self.mapping.source})"
        elif not any(map(str.isdigit, text)):
            expected = "a number (a line that is no row, as of a footer, has to go)"
        return RecordingError(f"{where} is {text!r}; expected {expected}")
