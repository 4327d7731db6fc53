"""Logs of every format: a path and a mapping in; a table, or channels with their own times, out.

`ces_data.log_formats` lists the formats; the module of each is imported when a file of it is opened.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_data.bags.storage import open_bag
from ces_data.config_file import first_line
from ces_data.log_formats import LOG_FORMATS, suggest_path
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_data.recording import Stamps, Values
from ces_observer.errors import CesError, RecordingError

MAX_TIME_S = 9.0e9  # stamps in nanoseconds end at 9.2e9 s, in the year 2262
MAX_ROWS, MAX_CELLS = 500_000, 8_000_000  # of a block of a table, or samples of a block of channels
MAX_NAMES = 30  # of columns or channels in a message
MDF_MAGIC = (b"MDF     ", b"UnFinMF ")
REMEDIES = {  # what to do about files that are not read
    **dict.fromkeys((".xlsx", ".xls", ".xlsm", ".ods"), "save the sheet as CSV"),
    **dict.fromkeys((".gz", ".zip", ".7z", ".bz2", ".xz", ".tar", ".rar"), "unpack it"),
    ".tdm": "export it as TDMS or CSV (DIAdem)",
    **dict.fromkeys((".dxd", ".d7d", ".dsd"), "export it as CSV, MAT or MDF from DewesoftX"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "only MATLAB's own HDF5 files (.mat) are; write CSV or Parquet"),
}
CAN_ASC = re.compile(rb"^\s*(date\s|base\s+(hex|dec)|//\s*version|Begin\s+Trigger)", re.IGNORECASE | re.MULTILINE)
BAGS = (".mcap", ".db3", ".bag")
LIBRARIES = {  # optional ones: the package to install, and the extra that has it
    "asammdf": ("asammdf", "mdf"),
    "can": ("python-can", "can"),
    "cantools": ("cantools", "can"),
    "h5py": ("h5py", "mat73"),
    "nptdms": ("nptdms", "tdms"),
    "pyarrow": ("pyarrow", "parquet"),
}
Progress = Callable[[float], None]  # is called with the share that is read


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
    """Columns of equal length, of a long table those of its first rows; `notes` say what the file's form is."""

    path: Path
    names: Sequence[str]
    notes: tuple[str, ...] = ()
    called = ""  # the name of its recording, if that is not the file's
    doubts: tuple[str, ...] = ()  # what a person has to choose, such as one of several runs
    breaks: Mapping[int, bool] = {}  # rows (from 0) at which a block begins; whether its names alone came again
    rows = ""  # the path to the table inside the file
    stated_Hz = 0.0  # the rate of sampling that the file's header states
    unread: Mapping[str, str] = {}  # names of what cannot be a column, each with the reason

    @property
    def width(self) -> int:
        """The number of columns."""
        return len(self.names)

    @abstractmethod
    def column(self, key: str | int) -> Values:
        """Return a column (n,), NaN where a sample is missing; raises RecordingError if it is none, or no numbers."""

    def blocks(self, columns: Sequence[LogColumn]) -> Iterator[LogTable]:
        """Yield the whole table in blocks of rows for these columns."""
        yield self

    def missing(self, key: str | int) -> NDArray[np.bool_] | None:
        """Return which rows have no sample in a column, (n,); None if all have one."""
        return None

    def stamps(self, column: LogColumn) -> Stamps | None:
        """Return the times of a column of dates or nanoseconds as exact stamps, (n,); None if it holds numbers."""
        return None

    def unit(self, key: str | int) -> str:
        """Return the unit that the file states for a column, '' if none."""
        return ""

    def title(self, key: str | int) -> str:
        """Return a better name of a column than its key, '' if the file states none."""
        return ""

    def first(self, key: str | int) -> float:
        """Return the number in the first row of a column."""
        return float(self.column(key)[0])

    def place(self, row: int) -> str:
        """Return the position of row `row` (from 0) for a message."""
        return f"row {row}"

    def _index(self, key: str | int, width: int) -> int:
        if isinstance(key, int) and key < width:
            return key
        if isinstance(key, str) and key in self.names:
            return list(self.names).index(key)
        columns = join_names(self.names) or f"columns 0 to {width - 1} without names"
        raise RecordingError(f"{self.path}: no column {key!r}; the table has {columns}")


class TimedLog(ABC):
    """A log whose channels have their own times."""

    path: Path
    notes: tuple[str, ...] = ()

    @abstractmethod
    def read(self, columns: Sequence[LogColumn]) -> list[LogSeries]:
        """Return the channels that the columns name, in this order; raises RecordingError if one is missing."""

    def blocks(self, columns: Sequence[LogColumn]) -> Iterator[list[LogSeries]]:
        """Yield the same in blocks, each of which goes on where the one before ends."""
        yield self.read(columns)

    @abstractmethod
    def read_all(self) -> list[LogSeries]:
        """Return every channel of numbers."""


def align_blocks(parts: Sequence[Iterator[LogSeries]]) -> Iterator[list[LogSeries]]:
    """Yield blocks of channels, each up to one time for all; each iterator yields the parts of one, one at least."""
    waiting: list[LogSeries] = [next(own) for own in parts]
    unread = set(range(len(parts)))
    while unread:
        ends = {i: int(waiting[i].stamps_ns[-1]) if len(waiting[i].stamps_ns) else -1 for i in unread}
        earliest = min(ends, key=lambda i: ends[i])
        more = next(parts[earliest], None)
        if more is None:
            unread.remove(earliest)
            continue
        cuts = [int(np.searchsorted(series.stamps_ns, ends[earliest], side="right")) for series in waiting]
        cuts[earliest] = len(waiting[earliest].stamps_ns)
        if any(cuts):
            yield [_slice(series, slice(cut)) for series, cut in zip(waiting, cuts, strict=True)]
        waiting = [_slice(series, slice(cut, None)) for series, cut in zip(waiting, cuts, strict=True)]
        waiting[earliest] = more
    yield waiting


def _slice(series: LogSeries, part: slice) -> LogSeries:
    return replace(series, stamps_ns=series.stamps_ns[part], values=series.values[part])


def join_names(names: Sequence[str]) -> str:
    """Return names for a message, the first 30 of them."""
    more = [f"{len(names) - MAX_NAMES} more"] if len(names) > MAX_NAMES else []
    return ", ".join([*map(str, names[:MAX_NAMES]), *more])


def import_reader(module: str, path: Path, what: str = "reading") -> Any:
    """Import one of the LIBRARIES; raises RecordingError that names the extra to install if it is missing."""
    try:
        return import_module(module)
    except ImportError:
        package, extra = LIBRARIES[module.partition(".")[0]]
        remedy = f"pip install 'ces_observer[{extra}]'"
        raise RecordingError(f"{path}: {what} {path.suffix or path.name} needs {package}: {remedy}") from None


def open_log(path: Path, mapping: DynoMapping, progress: Progress = lambda share: None) -> LogTable | TimedLog:
    """Open a log, text tables with `progress`; raises RecordingError if it lacks the mapping's or suffix's format."""
    refuse_bag(path)
    if not path.exists():
        raise RecordingError(f"{path}: cannot be read: No such file or directory{suggest_path(path)}")
    if not path.is_file():
        raise RecordingError(f"{path}: is no regular file; expected a log on disk")
    kind = mapping.format or find_format(path)
    if kind:
        return open_format(kind, path, mapping, progress)
    if hint := REMEDIES.get(path.suffix.lower()):
        raise RecordingError(f"{path}: is not read: {hint}")
    raise RecordingError(
        f"{path}: cannot tell the format from '{path.suffix}'; if it is one of {', '.join(LOG_FORMATS)}, set format in "
        f"{mapping.source}, or rename it (a text table: {path.stem}.csv)"
    )


def open_format(kind: str, path: Path, mapping: DynoMapping, progress: Progress) -> LogTable | TimedLog:
    """Open a log of a known format."""
    module = import_module(f"ces_data.logs.{kind}")
    try:
        log: LogTable | TimedLog = module.open_log(path, mapping, progress)
        return log
    except CesError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # of a library, for a damaged file
        raise RecordingError(f"{path}: not a {kind} file: {first_line(error)}") from None


def refuse_bag(path: Path) -> None:
    """Raise RecordingError if the file or folder is a rosbag2 recording, which all programs read as it is."""
    if path.suffix in BAGS or (path.is_dir() and (path / "metadata.yaml").is_file()):
        with open_bag(path):  # which may say that it is not of ROS 2
            pass
        raise RecordingError(f"{path}: a bag needs no import: ces info {path}")
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder; expected a log (.csv, .mat, .mf4, ...)")


def find_format(path: Path) -> str:
    """Return the format that the suffix or the first bytes say, '' if neither does."""
    suffix = path.suffix.lower()
    head = b""
    if suffix in (*LOG_FORMATS["csv"], ".asc") and path.is_file():
        with path.open("rb") as file:
            head = file.read(4096)
    if head[:8] in MDF_MAGIC:
        return "mdf"  # MDF 3 files often have the suffix .dat, as text tables do
    if suffix == ".asc" and head.strip() and not CAN_ASC.search(head):
        return "csv"
    return next((kind for kind, suffixes in LOG_FORMATS.items() if suffix in suffixes), "")
