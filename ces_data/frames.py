"""Recordings from tables in memory, whose columns and units are found as those of a log are, and back again."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from ces_data.logs.frame import FrameTable, is_frame
from ces_data.logs.log_import import to_recording
from ces_data.mapping.proposals import parse_mapping_without_force, propose_for
from ces_data.recording import Recording
from ces_data.tables import tabulate
from ces_observer.errors import CesError, RecordingError

NAME = "DataFrame"
EXAMPLE = "columns={'position': {'column': 'x', 'unit': 'mm'}, 'current': 0.5}"


def is_table(given: object) -> bool:
    """Return whether a value is a table in memory: a pandas DataFrame or a mapping of arrays."""
    return is_frame(given) or isinstance(given, Mapping)


def read_frame(
    table: Any, *, columns: Mapping[str, Any] | None = None, need: Sequence[str], name: str = ""
) -> Recording:
    """Return the recording in a DataFrame, or in a mapping of arrays (n,) by name.

    Time (a column, or the index: dates, durations, or numbers with a unit in the name), position, current and force are
    found by names, units and numbers, as `ces import` finds them. `columns` names those that are not found: each a
    column's name, a constant in SI units, or what a mapping file holds for a signal. Raises RecordingError.
    """
    if not is_table(table):
        raise CesError(f"{name or 'table'}: expected a DataFrame or a mapping of arrays; got a {type(table).__name__}")
    if not isinstance(columns or {}, Mapping):
        raise CesError(f"columns: expected columns by signal; {EXAMPLE}")
    name = name or (NAME if is_frame(table) else "arrays")
    log = FrameTable(table, name)
    proposal = propose_for(log, need=need)
    given = {signal: _as_source(signal, source) for signal, source in (columns or {}).items()}
    content = {**(yaml.safe_load(proposal.text) or {}), **given}
    if "rate" in given:
        content.pop("time", None)
    settled = {*given, *({"time"} if "rate" in given else ())}
    doubts = [text for text in proposal.doubts if text.partition(":")[0] not in settled]
    if doubts:
        raise RecordingError(f"{name}: {doubts[0]}; say which it is: {EXAMPLE}")
    for remark in proposal.remarks:
        warnings.warn(f"{name}: {remark}", stacklevel=4)
    return to_recording(log, parse_mapping_without_force(content, name))


def _as_source(signal: str, source: Any) -> Any:
    """Return what a mapping file would hold: the text of a column, or a number, is short for it."""
    if isinstance(source, str):
        return {"column": source}
    if isinstance(source, Mapping) or signal == "rate":
        return source
    try:
        return {"constant": float(source)}
    except (TypeError, ValueError):
        kind = type(source).__name__
        raise CesError(f"columns: {signal} is a {kind}; expected a name, a number or a mapping") from None


def to_frame(recording: Recording) -> Any:
    """Return a recording as a pandas DataFrame on the position's times [s], the index; units are in the names.

    Raises CesError without pandas.
    """
    pandas = import_pandas()
    table = tabulate(recording, {})
    values = {column.name: column.values for column in table.columns}
    for column in table.columns:
        if column.missing.any():
            values[column.name] = values[column.name].copy()
            values[column.name][column.missing] = float("nan")
    return pandas.DataFrame(values, index=pandas.Index(1e-9 * table.time_ns, name="time_s"))


def import_pandas() -> Any:
    """Return pandas; raises CesError that says how to install it."""
    try:
        import pandas
    except ImportError:
        raise CesError("a DataFrame needs pandas: pip install 'ces_observer[frames]'") from None
    return pandas
