"""Tables in memory, as logs: a pandas DataFrame with its index, or a mapping of arrays."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_data.logs.csv_cells import is_missing
from ces_data.logs.log_file import LogTable
from ces_data.logs.log_mapping import LogColumn
from ces_data.recording import Stamps, Values
from ces_observer.errors import RecordingError

TIMES = "mM"  # kinds of arrays of dates and durations
TEXT = "OUST"  # of text


class FrameTable(LogTable):
    """The columns of a DataFrame, or of a mapping of arrays, in which a single number stands for all rows.

    An index that has a name, or holds dates, durations or fractions, is the first column. `name` is that of the
    recording, and stands for a file's.
    """

    def __init__(self, content: Any, name: str) -> None:
        self.path, self.called = Path(name), name
        columns = _frame_columns(content) if is_frame(content) else [(str(key), content[key]) for key in content]
        self.names = tuple(column for column, _ in columns)
        self._arrays = [_as_array(values, f"{name}: column {column!r}") for column, values in columns]
        rows = max((len(array) for array in self._arrays if array.ndim), default=0)
        if not rows:
            raise RecordingError(f"{name}: no rows; expected columns of time, position, current and force")
        self._arrays = [array if array.ndim else np.full(rows, array) for array in self._arrays]

    def column(self, key: str | int) -> Values:
        """Return a column, NaN where it is missing; raises RecordingError if it holds no numbers."""
        array = self._array(key)
        if array.dtype.kind in TEXT:
            row, cell = next((i, str(cell)) for i, cell in enumerate(array.ravel()) if not _is_number(cell))
            remedy = "; give a decimal point" if _is_number(cell.replace(",", ".")) else ""
            raise RecordingError(f"{self.path}: row {row} of column {key!r} is {cell!r}; expected a number{remedy}")
        if array.dtype.kind not in "biuf":
            raise RecordingError(f"{self.path}: column {key!r} is {array.dtype}; expected numbers")
        return array.astype(np.float64)

    def missing(self, key: str | int) -> NDArray[np.bool_] | None:
        """Return which rows are NaN in a column, None if none is."""
        missing = np.isnan(self.column(key))
        return missing if missing.any() else None

    def stamps(self, column: LogColumn) -> Stamps | None:
        """Return the times of a column of dates, durations or whole nanoseconds; None for other numbers."""
        array = self._array(column.key)
        if array.dtype.kind in TIMES:
            if np.isnat(array).any():
                raise RecordingError(f"{self.path}: row {int(np.isnat(array).argmax())}: the time is missing")
            return array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64)
        return array.astype(np.int64) if array.dtype.kind in "iu" and column.unit == "ns" else None

    def _array(self, key: str | int) -> NDArray[Any]:
        return self._arrays[self._index(key, len(self.names))]


def is_frame(content: object) -> bool:
    """Return whether a value is a pandas DataFrame, without importing pandas."""
    return hasattr(content, "columns") and hasattr(content, "index") and hasattr(content, "dtypes")


def _frame_columns(frame: Any) -> list[tuple[str, Any]]:
    """Return names and values of a DataFrame's columns, an index that numbers no rows first."""
    columns = [(_name(name), frame.iloc[:, i]) for i, name in enumerate(frame.columns)]
    index = frame.index
    if getattr(index, "nlevels", 1) == 1 and (index.name is not None or np.dtype(_kind(index)).kind in TIMES + "f"):
        name = _name("time" if index.name is None else index.name)
        columns[:0] = [(name, index)] * (name not in dict(columns))
    return columns


def _name(name: object) -> str:
    return " ".join(map(str, name)) if isinstance(name, tuple) else str(name)


def _kind(values: Any) -> Any:
    """Return the NumPy type that holds values, of which pandas' own types (Float64, dates with a zone) have none."""
    kind = values.dtype
    if isinstance(kind, np.dtype):
        return kind
    return "M8[ns]" if hasattr(kind, "tz") else kind.type if issubclass(kind.type, np.generic) else "O"


def _as_array(values: Any, where: str) -> NDArray[Any]:
    """Return an array of numbers, dates or durations of shape (n,), or of one number; raises RecordingError."""
    if hasattr(values, "to_numpy") and getattr(values.dtype, "na_value", None) is not None:
        kind = np.dtype(_kind(values))
        whole = kind.kind in "biu" and values.isna().any()
        values = values.to_numpy(dtype=np.float64 if whole else kind, **({"na_value": np.nan} if whole else {}))
    try:
        array = np.asarray(values)
    except ValueError:
        raise RecordingError(f"{where} has rows of different lengths; expected one number a row") from None
    if array.dtype.kind in "OU":
        array = _read_text(array)
    if array.ndim > 1 and array.size != max(array.shape):
        raise RecordingError(f"{where} has shape {array.shape}; expected one number a row")
    return array if array.ndim <= 1 else array.ravel()


def _read_text(array: NDArray[Any]) -> NDArray[Any]:
    """Return objects or text as numbers, NaN for words that mean none, else as dates, if all are; else as text."""
    cells = [np.nan if _is_blank(cell) else cell for cell in array.ravel()]
    for given, kind in ((np.array(cells, dtype=object).reshape(array.shape), "f8"), (array, "M8[ns]")):
        with suppress(TypeError, ValueError):
            return given.astype(kind)
    return np.asarray([str(value) for value in array.ravel()])


def _is_blank(cell: object) -> bool:
    return isinstance(cell, str) and (not cell.strip() or is_missing(cell))


def _is_number(cell: str) -> bool:
    with suppress(ValueError):
        return bool(float(cell)) or True
    return False
