"""Tables and time series inside nested mappings and lists, from JSON and MATLAB files."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ces_data.config_file import first_line
from ces_data.logs.csv_cells import AmbiguousDateError, is_date, parse_dates
from ces_data.logs.log_file import MAX_TIME_S, LogSeries, LogTable, Progress, TimedLog
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_data.logs.matlab_objects import MatlabObject, describe_object, describe_objects
from ces_data.recording import Stamps, Values
from ces_observer.errors import RecordingError

TIME_KEYS = ("Time", "time", "t")
DATA_KEYS = ("Data", "data", "values", "Values", "value")
MIN_ROWS = 2
STEPS = re.compile(r"(?:[^.({[]|\([^)]*\)|\{[^}]*\}|\[[^\]]*\])+")  # of a path, between its points
INDEXED = re.compile(r"(.+?)(\((?:\d+|:,\d+)\)|\{\d+\}|\[\d+\])$")
DATA_OF = re.compile(r"(?:(.+)\.)?(\w+)Data(?:\(:,(\d+)\))?")  # columns of System Identification Toolbox's iddata
MAX_COLUMNS = 32  # of a matrix, that have names
NO_NUMBERS = (ValueError, TypeError, OverflowError)  # the last for a whole number that no float holds
COMPLEX = "holds complex numbers; expected real ones"


class TimedValues(NamedTuple):
    """Times [s] and values of a series, both (n,), and the unit that the file states for it."""

    seconds: Values
    values: Values
    unit: str = ""


def open_log(path: Path, mapping: DynoMapping, _: Progress) -> LogTable | TimedLog:
    """Read a JSON file, or one with a JSON value in each line."""
    text = path.read_bytes()
    try:
        tree = json.loads(text)
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise
        tree = [_read_line(path, *line) for line in enumerate(text.splitlines(), 1) if line[1].strip()]
    return open_tree(path, mapping, tree)


def _read_line(path: Path, number: int, line: bytes) -> Any:
    try:
        return json.loads(line)
    except ValueError as error:
        remedy = f"expected one in each line; make one list of several: jq -s . {shlex.quote(str(path))} > list.json"
        raise RecordingError(f"{path}:{number}: not a JSON value ({first_line(error)}); {remedy}") from None


def open_tree(path: Path, mapping: DynoMapping, tree: Any) -> LogTable | TimedLog:
    """Return the series if the mapping gives no time and its columns are series, else the table."""
    root = _follow_route(path, tree, mapping.rows)
    keys = [str(source.key) for source in mapping.signals.values() if isinstance(source, LogColumn)]
    if mapping.time is None and mapping.rate is None and isinstance(root, Mapping):
        listed = dict(_list_series(root))
        are_series = all(key in listed or _find_series(_follow_route(path, root, key)) for key in keys)
        if are_series if keys else listed:
            return TreeSeries(path, root)
    return TreeTable(path, mapping, tree)


class TreeTable(LogTable):
    """A table inside nested mappings and lists: a matrix, rows as lists or as mappings, or a mapping of columns."""

    def __init__(self, path: Path, mapping: DynoMapping, tree: Any) -> None:
        self.path = path
        runs = [] if mapping.rows or mapping.signals else _list_runs(tree)
        self.rows = mapping.rows if mapping.rows or mapping.signals else runs[0] if runs else _find_rows(tree)
        if runs:
            kind = "cells" if runs[0].endswith("}") else "runs"
            self.doubts = (f"rows: the file has {len(runs)} {kind}, {runs[0]} to {runs[-1]}; this is {runs[0]}",)
        self.tree, self.root = tree, _follow_route(path, tree, self.rows)
        if not len(self.root):
            raise RecordingError(f"{path}: '{mapping.rows or 'the file'}' is empty; expected rows of numbers")
        self.names = mapping.names or self._names_beside() or (() if mapping.signals else tuple(self._find_names()))
        if isinstance(self.root, Mapping) and not mapping.signals:
            objects = [(name, value) for name, value in _walk(self.root) if isinstance(value, MatlabObject)]
            self.unread = {name: describe_object(value, name) for name, value in objects}
            self.unread |= {str(n): f"'{n}' {COMPLEX}" for n, value in self.root.items() if _is_complex(value)}
            if self.unread and not self.names:
                raise RecordingError(f"{path}: {describe_objects(objects) or next(iter(self.unread.values()))}")

    def column(self, key: str | int) -> Values:
        """Return a column; raises RecordingError naming the row of a cell that is not a number."""
        cells = self._cells(key)
        if opaque := describe_object(cells, str(key)):
            raise RecordingError(f"{self.path}: {opaque}")
        if _is_complex(cells):
            raise RecordingError(f"{self.path}: column {key!r} {COMPLEX}")
        try:
            numbers = np.atleast_1d(np.asarray(cells, dtype=np.float64).squeeze())
        except NO_NUMBERS:
            rows = list(cells) if isinstance(cells, list | np.ndarray) else []
            bad = next((i for i, cell in enumerate(rows) if not isinstance(cell, int | float)), None)
            text = f"row {bad}: column {key!r} is {rows[bad]!r}; expected a number" if bad is not None else ""
            raise RecordingError(f"{self.path}: {text or f'column {key!r} has a cell that is not a number'}") from None
        if numbers.ndim != 1:
            raise RecordingError(f"{self.path}: column {key!r} has shape {numbers.shape}; expected one number a row")
        return numbers

    def stamps(self, column: LogColumn) -> Stamps | None:
        """Return the times of a column of dates, None for numbers."""
        cells = self._cells(column.key)
        if not isinstance(cells, list) or not cells or not isinstance(cells[0], str):
            return None
        try:
            return parse_dates([str(cell) for cell in cells], column.date)
        except AmbiguousDateError as error:
            text = f"{str(error)!r} may be month/day or day/month; set date: '%d/%m/%Y %H:%M:%S.%f' or '%m/%d/...'"
            raise RecordingError(f"{self.path}: column {column.key!r}: {text} in a mapping") from None
        except ValueError as error:
            bad, row = error.args
            expected = "expected a number, or a date like 2024-12-31T23:59:59.5Z (a mapping gives other forms: date:)"
            raise RecordingError(f"{self.path}: row {row}: column {column.key!r} is {bad!r}; {expected}") from None

    @property
    def width(self) -> int:
        """The number of columns by name, or of the first row."""
        rows = not isinstance(self.root, Mapping) and isinstance(self.root[0], list | np.ndarray)
        return len(self.root[0]) if rows else len(self.names)

    def title(self, key: str | int) -> str:
        """Return the name that an iddata's structure states for the column, as `InputName` for `InputData(:,2)`."""
        return self._beside(key, "Name")

    def unit(self, key: str | int) -> str:
        """Return the unit that it states, or that stands beside the column, '' if none."""
        beside = _look_up(self.root, str(key).rpartition(".")[0]) if isinstance(self.root, Mapping) else None
        return self._beside(key, "Unit") or (str(beside.get("unit", "")) if isinstance(beside, Mapping) else "")

    def _is_elsewhere(self, key: str) -> bool:
        """Return whether a column may be a path from the file on, and not one in the table."""
        return isinstance(self.tree, Mapping) and re.split(r"[.({\[]", key)[0] in self.tree

    def _beside(self, key: str | int, what: str) -> str:
        match = DATA_OF.fullmatch(str(key))
        holder: Any = self.root if match and isinstance(self.root, Mapping) else {}
        for step in match[1].split(".") if match and match[1] else []:
            holder = holder.get(step) if isinstance(holder, Mapping) else {}
        texts = holder.get(f"{match[2]}{what}", "") if match and isinstance(holder, Mapping) else ""
        several = [texts] if isinstance(texts, str) else list(texts)
        at = int(match[3] or 1) - 1 if match else 0
        return str(several[at]) if at < len(several) else ""

    def _names_beside(self) -> tuple[str, ...]:
        """Return the texts beside a matrix, one for each column, as pandas writes them with `split`."""
        several = self.tree.values() if isinstance(self.tree, Mapping) and not isinstance(self.root, Mapping) else ()
        lists = (list(v) for v in several if isinstance(v, list | np.ndarray) and len(v) == self.width)
        return next((tuple(map(str, v)) for v in lists if v and all(isinstance(item, str) for item in v)), ())

    def _find_names(self) -> Iterator[str]:
        """Yield the paths to the columns that have names; those of single numbers, such as a rate, after the arrays."""
        if isinstance(self.root, Mapping):
            arrays = list(_list_arrays(self.root))
            yield from arrays
            yield from (name for name, v in self.root.items() if isinstance(v, list) and v and is_date(str(v[0])))
            for name, value in _walk(self.root) if arrays else ():
                if not _is_complex(value) and np.size(value) == 1 and np.asarray(value).dtype.kind in "iuf":
                    yield name
        elif isinstance(self.root[0], Mapping):
            yield from (name for name, _ in _walk(self.root[0]))

    def _cells(self, key: str | int) -> Any:
        if isinstance(self.root, Mapping):
            return self.root[key] if str(key) in self.root else _follow_route(self.path, self.root, str(key), True)
        top = self.root[0]
        if isinstance(key, str) and isinstance(top, Mapping):
            bad = next((row for row, cells in enumerate(self.root) if not isinstance(cells, Mapping)), None)
            if bad is None:
                known = key in top or key in dict(_walk(top))
                return [_look_up(row, key) for row in self.root] if known else _follow_route(self.path, top, key)
        elif not isinstance(top, list | np.ndarray):
            raise RecordingError(f"{self.path}: a list of single values; expected rows, or columns by name")
        elif isinstance(key, str) and key not in self.names and self._is_elsewhere(key):
            return _follow_route(self.path, self.tree, key)
        else:
            i = self._index(key, len(top))
            if isinstance(self.root, np.ndarray):
                return self.root[:, i]
            whole = (isinstance(cells, list | np.ndarray) and len(cells) > i for cells in self.root)
            bad = next((row for row, good in enumerate(whole) if not good), None)
            if bad is None:
                return [row[i] for row in self.root]
        raise RecordingError(f"{self.path}: row {bad}: column {key!r} is missing")


class TreeSeries(TimedLog):
    """Time series inside nested mappings: structures of a time and its data, as Simulink's `Structure with time`.

    Times count from zero, or from the earliest of all series that are read together if that is before zero.
    """

    def __init__(self, path: Path, root: Any) -> None:
        self.path, self.root = path, root

    def read(self, columns: Sequence[LogColumn]) -> list[LogSeries]:
        """Return the series at the columns' paths."""
        listed, keys = dict(_list_series(self.root)), [str(column.key) for column in columns]
        return self._stamp([(k, listed.get(k) or _find_series(_follow_route(self.path, self.root, k))) for k in keys])

    def read_all(self) -> list[LogSeries]:
        """Return every series in the tree."""
        return self._stamp(list(_list_series(self.root)))

    def _stamp(self, series: Sequence[tuple[str, TimedValues | None]]) -> list[LogSeries]:
        """Return the series with stamps on one clock."""
        stamped = [(name, self._require_series(name, found)) for name, found in series]
        start_s = min(0.0, *(float(seconds.min()) for _, (seconds, _, _) in stamped)) if stamped else 0.0
        return [
            LogSeries(name, np.rint((seconds - start_s) * 1e9).astype(np.int64), values, unit, key=name)
            for name, (seconds, values, unit) in stamped
        ]

    def _require_series(self, name: str, series: TimedValues | None) -> TimedValues:
        """Return a series; raises RecordingError if they are missing, empty, of two lengths or no times."""
        where = f"{self.path}: '{name}'"
        if series is None:
            keys = f"{' or '.join(TIME_KEYS)} beside {' or '.join(DATA_KEYS)}"
            raise RecordingError(f"{where} is not a time series; expected a structure with {keys}")
        seconds, values, _ = series
        if len(seconds) != len(values) or not len(seconds):
            raise RecordingError(f"{where} has {len(seconds)} times for {len(values)} values; expected one for each")
        bad = next(iter(np.flatnonzero(~(np.abs(seconds) <= MAX_TIME_S))), None)
        if bad is not None:
            raise RecordingError(f"{where}: time {bad} is {seconds[bad]:g}; expected seconds, at most {MAX_TIME_S:g}")
        return series


def _follow_route(path: Path, tree: Any, route: str, scalar: bool = False) -> Any:
    """Return the table at a path of names, such as `results.data`; raises RecordingError for an unknown name."""
    for step in STEPS.findall(route):
        if not isinstance(tree, Mapping) or (step not in tree and not INDEXED.match(step)):
            names = ", ".join(str(key) for key in tree if _is_plain(key)) if isinstance(tree, Mapping) else "no names"
            raise RecordingError(f"{path}: no '{step}' in the path '{route}'; expected one of {names}")
        if step in tree:
            tree = tree[step]
        else:
            name, index = INDEXED.match(step).groups()  # type: ignore[union-attr]
            inner = _follow_route(path, tree, name)
            tree = _take_part(inner, index, f"{path}: '{route}'")
        if opaque := describe_object(tree, step):
            raise RecordingError(f"{path}: {opaque}")
    if not isinstance(tree, Mapping | list | np.ndarray) and not (scalar and isinstance(tree, int | float)):
        raise RecordingError(f"{path}: '{route}' is a {type(tree).__name__}; expected a table")
    return tree


def _look_up(row: Any, key: str) -> Any:
    """Return a cell of a row by its name, or by the names on the way to it; None if the row has none."""
    for step in [key] if key in row else key.split("."):
        row = row.get(step) if isinstance(row, Mapping) else None
    return row


def _take_part(value: Any, index: str, where: str) -> Any:
    """Return `run(2)` of an array of structures, `data{2}` of a cell array, column `z(:,2)`, or item [1]."""
    first, whole = 0 if index.startswith("[") else 1, ":" in index
    at = int(re.findall(r"\d+", index)[-1]) - first
    count = np.shape(value)[1] if whole and np.ndim(value) > 1 else len(value)
    if not 0 <= at < count:
        raise RecordingError(f"{where}: no part {index}; expected {first} to {count - 1 + first} there")
    return np.asarray(value)[:, at] if whole else value[at]


def _list_runs(tree: Any) -> list[str]:
    """Return the paths to the parts of the first array of structures, or cell array, whose parts hold arrays."""
    for name, value in _walk(tree) if isinstance(tree, Mapping) else ():
        is_cells = isinstance(value, np.ndarray) and value.dtype == object
        parts = list(value) if isinstance(value, list) or is_cells else []
        if len(parts) > 1 and all(isinstance(part, Mapping) and next(_list_arrays(part), None) for part in parts):
            return [f"{name}({i})" for i in range(1, 1 + len(parts))]
        if len(parts) > 1 and all(isinstance(part, np.ndarray) and part.ndim == 2 for part in parts):
            return [f"{name}{{{i}}}" for i in range(1, 1 + len(parts))]
    return []


def _is_plain(name: object) -> bool:
    """Return whether a name is a user's, not one of the format's own."""
    return not str(name).startswith(("__", "#"))


def _walk(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and value of everything in a tree that is no mapping itself."""
    for name, value in tree.items():
        if isinstance(value, Mapping) and _is_plain(name):
            yield from _walk(value, f"{prefix}{name}.")
        elif _is_plain(name):
            yield f"{prefix}{name}", value


def _list_arrays(tree: Mapping[str, Any]) -> Iterator[str]:
    """Yield the path of every array of numbers in a tree."""
    for name, value in _walk(tree):
        if (numbers := _as_numbers(value)) is not None and len(numbers) >= MIN_ROWS:
            yield name
        elif isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "biuf" and "." in name:
            yield from (f"{name}(:,{i + 1})" for i in range(min(MAX_COLUMNS, value.shape[1])) if len(value) >= MIN_ROWS)


def _find_series(tree: Any) -> TimedValues | None:
    """Return times [s] and values of a structure that holds both, None for anything else."""
    if not isinstance(tree, Mapping):
        return None
    time = next((tree[key] for key in TIME_KEYS if key in tree), None)
    signals = tree.get("signals")
    holder = signals if isinstance(signals, Mapping) else tree
    data = next((holder[key] for key in DATA_KEYS if key in holder), None)
    seconds, values = _as_numbers(time), _as_numbers(data)
    return None if seconds is None or values is None else TimedValues(seconds, values)


def _list_series(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, TimedValues]]:
    """Yield path and content of every time series in a tree."""
    for name, value in tree.items():
        if not isinstance(value, Mapping) or not _is_plain(name):
            continue
        if found := _find_series(value):
            yield f"{prefix}{name}", found
        elif named := list(_list_named(value)):
            yield from ((f"{prefix}{name}.{label}", series) for label, series in named)
        else:
            yield from _list_series(value, f"{prefix}{name}.")


def _list_named(tree: Mapping[str, Any]) -> Iterator[tuple[str, TimedValues]]:
    """Yield name and content of the series in an array of structures.

    Simulink's `structure with time` has `time` beside `signals` with `label` and `values`; ControlDesk's recordings
    have `Y` with `Name`, `Unit`, `Data`, and the number `XIndex` of their time in `X`.
    """
    time, x = _as_numbers(tree.get("time")), tree.get("X")
    several = isinstance(x, Mapping | list | np.ndarray)
    times: list[Mapping[str, Any]] = _structures(x) if several else [] if time is None else [{"Data": time}]
    for signal in _structures(tree.get("Y")) or _structures(tree.get("signals")):
        at = signal.get("XIndex", 1)
        at = int(at) - 1 if isinstance(at, int | float) and 1 <= at <= len(times) else 0
        seconds = _as_numbers(times[at].get("Data")) if times else None
        values = _as_numbers(signal.get("Data", signal.get("values")))
        label = signal.get("Name") or signal.get("label")
        if seconds is not None and values is not None and isinstance(label, str):
            yield label, TimedValues(seconds, values, str(signal.get("Unit") or ""))


def _structures(value: Any) -> list[Mapping[str, Any]]:
    """Return a structure, or those of an array."""
    several = [value] if isinstance(value, Mapping) else value if isinstance(value, list | np.ndarray) else []
    return [structure for structure in several if isinstance(structure, Mapping)]


def _is_complex(value: Any) -> bool:
    return isinstance(value, np.ndarray) and np.iscomplexobj(value)


def _find_rows(tree: Any, prefix: str = "") -> str:
    """Return the path to the first matrix, or list of rows or mappings, in a tree without named columns, else ''."""
    if isinstance(tree, Mapping) and {"columns", "data"} <= tree.keys():  # pandas' `split`, with an index beside
        return f"{prefix}data"
    if not isinstance(tree, Mapping) or next(_list_arrays(tree), None) is not None:
        return ""
    for name, value in tree.items():
        if not _is_plain(name):
            continue
        if isinstance(value, Mapping):
            inner = _find_rows(value, f"{prefix}{name}.")
            if inner or next(_list_arrays(value), None) is not None:
                return inner or f"{prefix}{name}"
        top = value[0] if isinstance(value, list | np.ndarray) and len(value) >= MIN_ROWS else None
        if isinstance(top, Mapping) or (isinstance(top, list | np.ndarray) and len(top) > 1):
            return f"{prefix}{name}"
    return ""


def _as_numbers(value: Any) -> Values | None:
    """Return an array of numbers in one direction as float64 (n,), None for anything else."""
    if value is None or isinstance(value, str | Mapping) or _is_complex(value):
        return None
    try:
        numbers = np.asarray(value, dtype=np.float64).squeeze()
    except NO_NUMBERS:
        return None
    return numbers if numbers.ndim == 1 else None
