"""Tables and time series inside nested mappings and lists, from JSON and MATLAB files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ces_data.logs.log_file import MAX_TIME_S, LogSeries, LogTable, TimedLog
from ces_data.logs.log_mapping import Column, DynoMapping
from ces_data.recording import Values
from ces_observer.errors import RecordingError

TIME_KEYS = ("Time", "time", "t")
DATA_KEYS = ("Data", "data", "values", "Values", "value")
MIN_ROWS = 2
NO_NUMBERS = (ValueError, TypeError, OverflowError)  # the last for a whole number that no float holds
MAX_SHOWN = 3
REMEDIES = {  # MATLAB code that saves an object NAME as a structure that is read
    "timeseries": "NAME = struct('time', NAME.Time, 'data', squeeze(NAME.Data)); save('plain.mat', 'NAME')",
    "table": "s = table2struct(NAME, 'ToScalar', true); save('plain.mat', '-struct', 's')",
    "timetable": "s = table2struct(timetable2table(NAME, 'ConvertRowTimes', false), 'ToScalar', true); "
    "t = NAME.Properties.RowTimes; s.t = seconds(t - t(1)); save('plain.mat', '-struct', 's')",
    "Simulink.SimulationData.Dataset": "s = struct(); for k = 1:NAME.numElements, e = NAME{k}; "
    "s.(matlab.lang.makeValidName(e.Name)) = struct('time', e.Values.Time, 'data', squeeze(e.Values.Data)); end; "
    "save('plain.mat', '-struct', 's')",
}


@dataclass(frozen=True)
class MatlabObject:
    """An object, whose content is not read; `kind` is its class."""

    kind: str


def open_log(path: Path, mapping: DynoMapping, _: Callable[[float], None]) -> LogTable | TimedLog:
    """Read a JSON file."""
    return open_tree(path, mapping, json.loads(path.read_bytes()))


def open_tree(path: Path, mapping: DynoMapping, tree: Any) -> LogTable | TimedLog:
    """Return the series if the mapping gives no time and its columns are series, else the table."""
    root = follow_route(path, tree, mapping.rows)
    columns = [source for source in mapping.signals.values() if isinstance(source, Column)]
    if mapping.time is None and mapping.rate is None and isinstance(root, Mapping):
        listed = dict(list_series(root))
        if columns and all(str(c.key) in listed or find_series(follow_route(path, root, str(c.key))) for c in columns):
            return TreeSeries(path, root)
        if not columns and listed:
            return TreeSeries(path, root)
    return TreeTable(path, mapping, tree)


class TimedValues(NamedTuple):
    """Times [s] and values of a series, both (n,), and the unit that the file states for it."""

    seconds: Values
    values: Values
    unit: str = ""


class TreeTable(LogTable):
    """A table inside nested mappings and lists: a matrix, rows as lists or as mappings, or a mapping of columns."""

    def __init__(self, path: Path, mapping: DynoMapping, tree: Any) -> None:
        self.path = path
        self.rows = mapping.rows if mapping.rows or mapping.signals else find_rows(tree)
        self.root = follow_route(path, tree, self.rows)
        if not len(self.root):
            raise RecordingError(f"{path}: '{mapping.rows or 'the file'}' is empty; expected rows of numbers")
        self.names = mapping.names or (() if mapping.signals else tuple(self._find_names()))
        if isinstance(self.root, Mapping) and not mapping.signals:
            self.unread = dict(_list_unread(self.root))
            if self.unread and not self.names:
                raise RecordingError(f"{path}: {describe_objects(self.root) or next(iter(self.unread.values()))}")

    def column(self, key: str | int) -> Values:
        """Return a column; raises RecordingError naming the row of a cell that is not a number."""
        cells = self._cells(key)
        if opaque := describe_object(cells, str(key)):
            raise RecordingError(f"{self.path}: {opaque}")
        if _is_complex(cells):
            raise RecordingError(f"{self.path}: column {key!r} holds complex numbers; expected real ones")
        try:
            numbers = np.atleast_1d(np.asarray(cells, dtype=np.float64).squeeze())
        except NO_NUMBERS:
            raise self._bad_cell(cells, key) from None
        if numbers.ndim != 1:
            raise RecordingError(f"{self.path}: column {key!r} has shape {numbers.shape}; expected one number a row")
        return numbers

    def place(self, row: int) -> str:
        """Return the row in the table."""
        return f"row {row}"

    @property
    def width(self) -> int:
        """The number of columns by name, or of the first row."""
        rows = not isinstance(self.root, Mapping) and isinstance(self.root[0], list | np.ndarray)
        return len(self.root[0]) if rows else len(self.names)

    def _find_names(self) -> Iterator[str]:
        """Yield the paths to the columns that have names."""
        if isinstance(self.root, Mapping):
            arrays = [name for name, _ in list_arrays(self.root)]
            yield from arrays
            yield from list_single_numbers(self.root) if arrays else ()
        elif isinstance(self.root[0], Mapping):
            yield from (str(name) for name in self.root[0])

    def _cells(self, key: str | int) -> Any:
        if isinstance(self.root, Mapping):
            return self.root[key] if str(key) in self.root else follow_route(self.path, self.root, str(key))
        if isinstance(key, str) and isinstance(self.root[0], Mapping):
            self._require_rows(lambda row: isinstance(row, Mapping), key)
            first = self.root[0]
            return [row.get(key) for row in self.root] if key in first else follow_route(self.path, first, key)
        if not isinstance(self.root[0], list | np.ndarray):
            raise RecordingError(f"{self.path}: a list of single values; expected rows, or columns by name")
        i = self._index(key, len(self.root[0]))
        if isinstance(self.root, np.ndarray):
            return self.root[:, i]
        self._require_rows(lambda row: isinstance(row, list | np.ndarray) and len(row) > i, key)
        return [row[i] for row in self.root]

    def _require_rows(self, is_good: Callable[[Any], bool], key: str | int) -> None:
        """Raise RecordingError at the first row that does not have the form of the others."""
        bad = next((number for number, row in enumerate(self.root) if not is_good(row)), None)
        if bad is not None:
            raise RecordingError(f"{self.path}: row {bad}: column {key!r} is missing")

    def _bad_cell(self, cells: Any, key: str | int) -> RecordingError:
        for row, cell in enumerate(cells if isinstance(cells, list | np.ndarray) else ()):
            if not isinstance(cell, int | float):
                return RecordingError(f"{self.path}: row {row}: column {key!r} is {cell!r}; expected a number")
        return RecordingError(f"{self.path}: column {key!r} has a cell that is not a number")


class TreeSeries(TimedLog):
    """Time series inside nested mappings: structures of a time and its data, as Simulink's `Structure with time`.

    Times count from zero, or from the earliest of all series that are read together if that is before zero.
    """

    def __init__(self, path: Path, root: Any) -> None:
        self.path, self.root = path, root

    def read(self, columns: Any) -> list[LogSeries]:
        """Return the series at the columns' paths."""
        listed = dict(list_series(self.root))
        return self._stamp([(str(c.key), listed.get(str(c.key)) or find_series(self._at(c))) for c in columns])

    def read_all(self) -> list[LogSeries]:
        """Return every series in the tree."""
        return self._stamp(list(list_series(self.root)))

    def _at(self, column: Column) -> Any:
        return follow_route(self.path, self.root, str(column.key))

    def _stamp(self, series: Sequence[tuple[str, TimedValues | None]]) -> list[LogSeries]:
        """Return the series with stamps on one clock."""
        known = [(name, self._require_series(name, found)) for name, found in series]
        start_s = min((float(timed.seconds.min()) for _, timed in known), default=0.0)
        return [
            LogSeries(
                name,
                np.rint((timed.seconds - min(0.0, start_s)) * 1e9).astype(np.int64),
                timed.values,
                timed.unit,
                key=name,
            )
            for name, timed in known
        ]

    def _require_series(self, name: str, found: TimedValues | None) -> TimedValues:
        """Return a series; raises RecordingError if they are missing, empty, of two lengths or no times."""
        where = f"{self.path}: '{name}'"
        if found is None:
            keys = f"{' or '.join(TIME_KEYS)} beside {' or '.join(DATA_KEYS)}"
            raise RecordingError(f"{where} is not a time series; expected a structure with {keys}")
        seconds, values, _ = found
        if len(seconds) != len(values):
            raise RecordingError(f"{where} has {len(seconds)} times for {len(values)} values")
        if not len(seconds):
            raise RecordingError(f"{where} is empty; expected samples")
        bad = np.flatnonzero(~(np.abs(seconds) <= MAX_TIME_S))
        if len(bad):
            raise RecordingError(
                f"{where}: time {bad[0]} is {seconds[bad[0]]:g}; expected seconds, at most {MAX_TIME_S:g}"
            )
        return found


def follow_route(path: Path, tree: Any, route: str) -> Any:
    """Return the table at a path of names, such as `results.data`; raises RecordingError for an unknown name."""
    for step in route.split(".") if route else []:
        if not isinstance(tree, Mapping) or step not in tree:
            raise RecordingError(f"{path}: no '{step}' in the path '{route}'; expected one of {_keys(tree)}")
        tree = tree[step]
        if opaque := describe_object(tree, step):
            raise RecordingError(f"{path}: {opaque}")
    if not isinstance(tree, Mapping | list | np.ndarray):
        raise RecordingError(f"{path}: '{route}' is a {type(tree).__name__}; expected a table")
    return tree


def find_series(tree: Any) -> TimedValues | None:
    """Return times [s] and values of a structure that holds both, None for anything else."""
    if not isinstance(tree, Mapping):
        return None
    time = next((tree[key] for key in TIME_KEYS if key in tree), None)
    signals = tree.get("signals")
    holder = signals if isinstance(signals, Mapping) else tree
    data = next((holder[key] for key in DATA_KEYS if key in holder), None)
    seconds, values = as_numbers(time), as_numbers(data)
    return None if seconds is None or values is None else TimedValues(seconds, values)


def list_series(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, TimedValues]]:
    """Yield path and content of every time series in a tree."""
    for name, value in tree.items():
        if not isinstance(value, Mapping) or str(name).startswith(("__", "#")):
            continue
        found = find_series(value)
        if found:
            yield f"{prefix}{name}", found
        elif named := list(_list_named(value)):
            yield from ((f"{prefix}{name}.{label}", series) for label, series in named)
        else:
            yield from list_series(value, f"{prefix}{name}.")


def _list_named(tree: Mapping[str, Any]) -> Iterator[tuple[str, TimedValues]]:
    """Yield name and content of the series in an array of structures.

    Simulink's `structure with time` has `time` beside `signals` with `label` and `values`; ControlDesk's recordings
    have `Y` with `Name`, `Unit`, `Data`, and the number `XIndex` of their time in `X`.
    """
    times = _structures(tree.get("X"), as_numbers(tree.get("time")))
    for signal in _structures(tree.get("Y"), None) or _structures(tree.get("signals"), None):
        at = signal.get("XIndex", 1)
        at = int(at) - 1 if isinstance(at, int | float) and 1 <= at <= len(times) else 0
        seconds = as_numbers(times[at].get("Data")) if times else None
        values = as_numbers(signal.get("Data", signal.get("values")))
        label = signal.get("Name") or signal.get("label")
        if seconds is not None and values is not None and isinstance(label, str):
            yield label, TimedValues(seconds, values, str(signal.get("Unit") or ""))


def _structures(value: Any, seconds: Values | None) -> list[Mapping[str, Any]]:
    """Return a structure, or those of an array; one with these times if the value is neither."""
    if isinstance(value, Mapping):
        return [value]
    if isinstance(value, list | np.ndarray):
        return [one for one in value if isinstance(one, Mapping)]
    return [] if seconds is None else [{"Data": seconds}]


def list_arrays(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Values]]:
    """Yield path and content of every array of numbers in a tree."""
    for name, value in tree.items():
        if str(name).startswith(("__", "#")):
            continue
        if isinstance(value, Mapping):
            yield from list_arrays(value, f"{prefix}{name}.")
        elif (numbers := as_numbers(value)) is not None and len(numbers) >= MIN_ROWS:
            yield f"{prefix}{name}", numbers


def list_single_numbers(tree: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Yield the path of every number that stands alone in a tree, such as the rate of its arrays."""
    for name, value in tree.items():
        if str(name).startswith(("__", "#")):
            continue
        if isinstance(value, Mapping):
            yield from list_single_numbers(value, f"{prefix}{name}.")
        elif not _is_complex(value) and np.size(value) == 1 and np.asarray(value).dtype.kind in "iuf":
            yield f"{prefix}{name}"


def _list_unread(tree: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield name and reason of MATLAB objects and of complex numbers in a tree."""
    for name, value in list_objects(tree):
        yield name, describe_object(value, name)
    for name, value in tree.items():
        if _is_complex(value):
            yield str(name), f"'{name}' holds complex numbers; expected real ones"


def _is_complex(value: Any) -> bool:
    return isinstance(value, np.ndarray) and np.iscomplexobj(value)


def find_rows(tree: Any, prefix: str = "") -> str:
    """Return the path to the first table of rows in a tree that has no columns by name, '' if it has or has none."""
    if not isinstance(tree, Mapping) or any(True for _ in list_arrays(tree)):
        return ""
    for name, value in tree.items():
        if str(name).startswith(("__", "#")):
            continue
        if isinstance(value, Mapping):
            found = find_rows(value, f"{prefix}{name}.")
            if found or any(True for _ in list_arrays(value)):
                return found or f"{prefix}{name}"
        elif _are_rows(value):
            return f"{prefix}{name}"
    return ""


def _are_rows(value: Any) -> bool:
    """Return whether a value is a matrix, or a list of rows or of mappings."""
    if not isinstance(value, list | np.ndarray) or len(value) < MIN_ROWS:
        return False
    return isinstance(value[0], Mapping) or (isinstance(value[0], list | np.ndarray) and len(value[0]) > 1)


def as_numbers(value: Any) -> Values | None:
    """Return an array of numbers in one direction as float64 (n,), None for anything else."""
    if value is None or isinstance(value, str | Mapping) or _is_complex(value):
        return None
    try:
        numbers = np.asarray(value, dtype=np.float64).squeeze()
    except NO_NUMBERS:
        return None
    return numbers if numbers.ndim == 1 else None


def _keys(tree: Any) -> str:
    if not isinstance(tree, Mapping):
        return "no names"
    return ", ".join(str(key) for key in tree if not str(key).startswith(("__", "#")))


def list_objects(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, MatlabObject]]:
    """Yield path and object of every object in a tree."""
    for name, value in tree.items():
        if isinstance(value, MatlabObject):
            yield f"{prefix}{name}", value
        elif isinstance(value, Mapping) and not str(name).startswith(("__", "#")):
            yield from list_objects(value, f"{prefix}{name}.")


def describe_object(value: object, where: str) -> str:
    """Return what to do about a value that is a MATLAB object, '' for any other value."""
    if not isinstance(value, MatlabObject):
        return ""
    code = REMEDIES.get(value.kind, "").replace("NAME", where)
    remedy = f"in MATLAB: {code}" if code else "save its numbers as vectors or as a structure"
    return f"'{where}' is a MATLAB object ({value.kind}), which is not read; {remedy}"


def describe_objects(tree: Mapping[str, Any]) -> str:
    """Return which objects a tree holds and what to do about one of them, '' if it holds none."""
    found = sorted(list_objects(tree), key=lambda one: one[1].kind not in REMEDIES)
    if not found:
        return ""
    first = describe_object(found[0][1], found[0][0])
    others = [f"'{name}' ({value.kind})" for name, value in found[1 : 1 + MAX_SHOWN]]
    more = [f"{len(found) - 1 - MAX_SHOWN} more"] if len(found) > 1 + MAX_SHOWN else []
    return f"{first}; likewise {', '.join([*others, *more])}" if others else first
