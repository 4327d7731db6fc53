"""What the readers of all log formats give: tables, and logs whose channels have their own times."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_identify.recordings.log_mapping import Column
from ces_identify.recordings.recording import Stamps, Values
from ces_observer.errors import RecordingError

MAX_TIME_S = 9.0e9  # stamps in nanoseconds end at 9.2e9 s, in the year 2262
MAX_NAMES = 30  # of columns or channels in a message


@dataclass(frozen=True)
class LogSeries:
    """A channel with its own times: `stamps_ns` int64 and `values` float64, both (n,); `unit` as the log spells it."""

    label: str
    stamps_ns: Stamps
    values: Values
    unit: str = ""
    key: str = ""
    group: str | int | None = None


class LogTable(ABC):
    """Columns of equal length; `notes` say what was found out about the file's form."""

    path: Path
    names: Sequence[str]
    notes: tuple[str, ...] = ()
    rows = ""  # the path to the table inside the file
    unread: Mapping[str, str] = {}  # names of what cannot be a column, each with the reason

    @abstractmethod
    def column(self, key: str | int) -> Values:
        """Return a column, shape (n,), NaN where a sample is missing.

        Raises RecordingError if the column is missing or has a cell that is not a number.
        """

    def missing(self, key: str | int) -> NDArray[np.bool_] | None:
        """Return which rows have no sample in a column, (n,); None if all have one."""
        return None

    def stamps(self, column: Column) -> Stamps | None:
        """Return the times of a column of dates or nanoseconds as exact stamps, (n,); None if it holds numbers."""
        return None

    def unit(self, key: str | int) -> str:
        """Return the unit that the file states for a column, '' if none."""
        return ""

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
            return list(self.names).index(key)
        columns = join_names(self.names) or f"columns 0 to {width - 1} without names"
        raise RecordingError(f"{self.path}: no column {key!r}; the table has {columns}{self._hint(width)}")

    def _hint(self, _: int) -> str:
        return ""


class TimedLog(ABC):
    """A log whose channels have their own times."""

    path: Path
    notes: tuple[str, ...] = ()

    @abstractmethod
    def read(self, columns: Sequence[Column]) -> list[LogSeries]:
        """Return the channels that the columns name, in this order; raises RecordingError if one is missing."""

    @abstractmethod
    def read_all(self) -> list[LogSeries]:
        """Return every channel of numbers."""


def join_names(names: Sequence[str]) -> str:
    """Return names for a message, the first 30 of them."""
    more = [f"{len(names) - MAX_NAMES} more"] if len(names) > MAX_NAMES else []
    return ", ".join([*map(str, names[:MAX_NAMES]), *more])


def import_reader(module: str, package: str, extra: str, path: Path) -> Any:
    """Import an optional library; raises RecordingError that names the extra to install if it is missing."""
    try:
        return import_module(module)
    except ImportError:
        raise RecordingError(
            f"{path}: reading {path.suffix or path.name} needs {package}: pip install 'ces_observer[{extra}]'"
        ) from None
