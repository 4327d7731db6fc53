"""A dyno's log file as a table: columns of numbers by name or number, from CSV, JSON or MATLAB files."""

from __future__ import annotations

import csv
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from ces_identify.recordings.log_mapping import DynoMapping
from ces_identify.recordings.recording import Values
from ces_observer.errors import RecordingError

SUFFIXES = {".csv": "csv", ".txt": "csv", ".dat": "csv", ".tsv": "csv", ".json": "json", ".mat": "mat"}
DELIMITERS = {",": "','", ";": "';'", "\t": "'\\t'", " ": "' '", "|": "'|'"}


class LogTable(ABC):
    """Columns of equal length."""

    path: Path
    names: Sequence[str]

    @abstractmethod
    def column(self, key: str | int) -> Values:
        """Return a column, shape (n,); raises RecordingError if it is missing or has a cell that is not a number."""

    def first(self, key: str | int) -> float:
        """Return the number in the first row of a column."""
        return float(self.column(key)[0])

    @abstractmethod
    def place(self, row: int) -> str:
        """Return the position of row `row` (from 0) for a message."""

    def _index(self, key: str | int, width: int) -> int:
        if isinstance(key, int) and key < width:
            return key
        if isinstance(key, str) and key in self.names:
            return self.names.index(key)
        columns = ", ".join(self.names) or f"columns 0 to {width - 1} without names"
        raise RecordingError(f"{self.path}: no column {key!r}; the table has {columns}{self._hint(width)}")

    def _hint(self, _: int) -> str:
        return ""


def read_table(path: Path, mapping: DynoMapping) -> LogTable:
    """Read a log; raises RecordingError if it does not have the format of the mapping or the suffix."""
    kind = mapping.format or SUFFIXES.get(path.suffix.lower(), "")
    try:
        if kind == "csv":
            return CsvTable(path, mapping)
        if kind == "json":
            return TreeTable(path, mapping, json.loads(path.read_bytes()))
        if kind == "mat":
            return TreeTable(path, mapping, scipy.io.loadmat(path, simplify_cells=True))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except NotImplementedError:
        raise RecordingError(f"{path}: a MATLAB 7.3 file; save it with save(..., '-v7')") from None
    except (ValueError, TypeError, RecursionError) as error:
        raise RecordingError(f"{path}: not a {kind} file: {str(error).splitlines()[0]}") from None
    raise RecordingError(f"{path}: cannot tell the format from '{path.suffix}'; set format in {mapping.source}")


class CsvTable(LogTable):
    """A table of text cells, converted to numbers column by column."""

    def __init__(self, path: Path, mapping: DynoMapping) -> None:
        self.path, self.mapping = path, mapping
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            lines = list(self._lines(file))
        if not lines:
            raise RecordingError(f"{path}: the file is empty; expected a header and rows of numbers")
        head = self._header_lines(lines)
        self.rows = lines[head:]
        self.names = mapping.names or (self._names(lines[head - 1][1]) if head else ())
        if not self.rows:
            raise RecordingError(f"{path}: no rows of numbers after {head} header lines")

    def column(self, key: str | int) -> Values:
        """Return a column; raises RecordingError naming the line of a cell that is not a number."""
        return self._numbers(key, self.rows)

    def first(self, key: str | int) -> float:
        """Return the number in the first row; the cells below may be empty."""
        return float(self._numbers(key, self.rows[:1])[0])

    def place(self, row: int) -> str:
        """Return the line in the file."""
        return f"line {self.rows[row][0]}"

    def _numbers(self, key: str | int, rows: list[tuple[int, list[str]]]) -> Values:
        i = self._index(key, max(len(self.names), len(self.rows[0][1])))
        point = self.mapping.decimal
        try:
            return np.array([float(cells[i].replace(point, ".")) for _, cells in rows], dtype=np.float64)
        except (ValueError, IndexError):
            raise self._bad_cell(i, key) from None

    def _lines(self, file: Any) -> Iterator[tuple[int, list[str]]]:
        """Yield number and cells of each line that is not blank."""
        reader = csv.reader(file, delimiter=self.mapping.delimiter, skipinitialspace=True)
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells

    def _header_lines(self, lines: list[tuple[int, list[str]]]) -> int:
        """Return the number of lines before the first row."""
        count = self.mapping.header_lines
        if count is not None:
            return sum(number <= count for number, _ in lines)
        return 0 if all(_is_number(cell, self.mapping.decimal) for cell in self._names(lines[0][1])) else 1

    def _names(self, cells: Sequence[str]) -> tuple[str, ...]:
        """Return the names in a header line, without the empty ones after trailing delimiters."""
        names = [cell.strip() for cell in cells]
        while names and not names[-1]:
            names.pop()
        return tuple(names)

    def _hint(self, width: int) -> str:
        """Suggest another delimiter if the only column contains one."""
        text = self.names[0] if self.names else self.rows[0][1][0]
        others = [shown for mark, shown in DELIMITERS.items() if mark in text and mark != self.mapping.delimiter]
        return f"; set delimiter: {others[0]} in {self.mapping.source}?" if width == 1 and others else ""

    def _bad_cell(self, i: int, key: str | int) -> RecordingError:
        name = f"'{self.names[i]}'" if i < len(self.names) else str(key)
        for line, cells in self.rows:
            if i >= len(cells):
                return RecordingError(f"{self.path}:{line}: column {name} is missing; the line has {len(cells)} cells")
            if not _is_number(cells[i], self.mapping.decimal):
                return RecordingError(f"{self.path}:{line}: column {name} is {cells[i]!r}; expected a number")
        return RecordingError(f"{self.path}: column {name} has a cell that is not a number")


class TreeTable(LogTable):
    """A table inside nested mappings and lists: a matrix, rows as lists or as mappings, or a mapping of columns."""

    def __init__(self, path: Path, mapping: DynoMapping, tree: Any) -> None:
        self.path, self.names = path, mapping.names
        self.root = self._follow(tree, mapping.rows)
        if not len(self.root):
            raise RecordingError(f"{path}: '{mapping.rows or 'the file'}' is empty; expected rows of numbers")

    def column(self, key: str | int) -> Values:
        """Return a column; raises RecordingError naming the row of a cell that is not a number."""
        cells = self._cells(key)
        try:
            numbers = np.atleast_1d(np.asarray(cells, dtype=np.float64).squeeze())
        except (ValueError, TypeError):
            raise self._bad_cell(cells, key) from None
        if numbers.ndim != 1:
            raise RecordingError(f"{self.path}: column {key!r} has shape {numbers.shape}; expected one number a row")
        return numbers

    def place(self, row: int) -> str:
        """Return the row in the table."""
        return f"row {row}"

    def _follow(self, tree: Any, route: str) -> Any:
        for step in route.split(".") if route else []:
            if not isinstance(tree, dict) or step not in tree:
                raise RecordingError(f"{self.path}: no '{step}' in the path '{route}'; expected one of {_keys(tree)}")
            tree = tree[step]
        if not isinstance(tree, dict | list | np.ndarray):
            raise RecordingError(f"{self.path}: '{route}' is a {type(tree).__name__}; expected a table")
        return tree

    def _cells(self, key: str | int) -> Any:
        if isinstance(self.root, dict):
            return self.root[key] if key in self.root else self._follow(self.root, str(key))
        if isinstance(key, str) and isinstance(self.root[0], dict):
            return [row.get(key) for row in self.root] if key in self.root[0] else self._follow(self.root[0], key)
        i = self._index(key, np.size(self.root[0]))
        return [row[i] for row in self.root]

    def _bad_cell(self, cells: Any, key: str | int) -> RecordingError:
        for row, cell in enumerate(cells):
            if not isinstance(cell, int | float):
                return RecordingError(f"{self.path}: row {row}: column {key!r} is {cell!r}; expected a number")
        return RecordingError(f"{self.path}: column {key!r} has a cell that is not a number")


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _keys(tree: Any) -> str:
    return (
        ", ".join(str(key) for key in tree if not str(key).startswith("__")) if isinstance(tree, dict) else "no names"
    )
