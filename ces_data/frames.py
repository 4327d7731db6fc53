"""Recordings from tables in memory, whose columns and units are found as those of a log are, and back again."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from ces_data.findings import warn
from ces_data.logs.frame import FrameTable, is_frame
from ces_data.logs.log_file import LogTable, TimedLog
from ces_data.logs.log_import import to_recording
from ces_data.logs.log_mapping import parse_mapping_without_force
from ces_data.mapping.doubts import NOT_READ
from ces_data.mapping.proposals import propose_for
from ces_data.mapping.rating import GUESSED
from ces_data.recording import Recording
from ces_data.tables import DataColumn, tabulate
from ces_data.units import split_unit
from ces_observer.errors import CesError, RecordingError
from ces_observer.signals import UNITS

NAME = "DataFrame"
TURNED = re.compile(r"(\w+) from '([^']*)' \[[^]]*sign turned\]")  # in what was taken
EXAMPLE = "columns={'position': {'column': 'x', 'unit': 'mm'}, 'current': 0.5}"


def is_table(given: object) -> bool:
    """Return whether a value is a table in memory: a pandas DataFrame or a mapping of arrays."""
    return is_frame(given) or isinstance(given, Mapping)


def read_frame(
    table: Any, *, columns: Mapping[str, Any] | None = None, need: Sequence[str], name: str = "", number: int = 0
) -> Recording:
    """Return the recording in a DataFrame, or in a mapping of arrays (n,) by name.

    Time (a column, or the index: dates, durations, or numbers with a unit in the name), position, current and force are
    found by names, units and numbers, as `ces import` finds them. `columns` names those that are not found: each a
    column's name, a constant in SI units, or what a mapping file holds for a signal; a column whose unit is not said
    has that in its name. `number` tells tables without a `name` apart. Raises RecordingError.
    """
    if not is_table(table):
        raise CesError(f"{name or 'table'}: expected a DataFrame or a mapping of arrays; got a {type(table).__name__}")
    if not isinstance(name, str):
        raise CesError(f"name: expected text; got {name!r}")
    named = getattr(table, "attrs", {}).get("name", "")
    name = name or str(named) or (NAME if is_frame(table) else "arrays") + (f" {number}" if number else "")
    return read_columns(FrameTable(table, name), columns or {}, need)


def read_columns(log: LogTable | TimedLog, columns: Mapping[str, Any], need: Sequence[str]) -> Recording:
    """Return the recording in an open log, of which `columns` names what `read_frame` says. Raises RecordingError."""
    if not isinstance(columns, Mapping):
        raise CesError(f"columns: expected columns by signal; {EXAMPLE}")
    names = getattr(log, "names", ())
    reversed_keys = [key for key, value in columns.items() if key not in UNITS and key in names and str(value) in UNITS]
    if reversed_keys:
        raise CesError(f"columns: '{reversed_keys[0]}' is a column; expected signals, each with its column: {EXAMPLE}")
    name = str(log.path)
    proposal = propose_for(log, need=need)
    found = yaml.safe_load(proposal.text) or {}
    given = {signal: _as_source(signal, source, found) for signal, source in columns.items()}
    content = {**found, **given}
    if "rate" in given:
        content.pop("time", None)
    settled = {*given, *({"time"} if "rate" in given else ())}
    named = [s for s in given if s != "rate" and not _has_unit(columns[s]) and _same_column(given[s], found, s)]
    guessed = tuple(f"{signal}: {GUESSED}" for signal in named)
    doubts = [text for text in proposal.doubts if text.partition(":")[0] not in settled or text.startswith(guessed)]
    if doubts:
        raise RecordingError(f"{name}: ", proposal.tell(doubts))
    for remark in (text for text in proposal.remarks if text.partition(":")[0] not in settled):
        warn(f"{name}: {remark}")
    taken = [text for text in proposal.found if text.partition(" ")[0] not in settled]
    taken += [_describe_given(signal, source) for signal, source in given.items() if isinstance(source, Mapping)]
    taken += [text for text in proposal.remarks if text.endswith(NOT_READ)]
    recording = replace(to_recording(log, parse_mapping_without_force(content, name)), taken=", ".join(taken))
    return warn_of_signs(recording)


def warn_of_signs(recording: Recording) -> Recording:
    """Return the recording; warn of a column that was turned, against which scripts would compare a simulated force."""
    for signal, column in TURNED.findall(recording.taken):
        text = (
            f"'{column}' is positive in rebound, so that its sign is turned; every force that comes back is positive in"
        )
        warn(f"{recording.name}: {signal}: {text} compression: negate one of the two to compare them")
    return recording


def _same_column(source: Mapping[str, Any], found: Mapping[str, Any], signal: str) -> Mapping[str, Any]:
    """Return what was found for a signal if it is the same column, else nothing."""
    other = found.get(signal)
    return other if isinstance(other, Mapping) and str(other.get("column")) == str(source.get("column")) else {}


def _has_unit(source: Any) -> bool:
    """Return whether a user said the unit of a column, too."""
    return isinstance(source, Mapping) and bool({"unit", "scale"} & {*source})


def _describe_given(signal: str, source: Mapping[str, Any]) -> str:
    """Return what a user named for a signal, as what was found is shown."""
    if "column" not in source:
        return f"{signal} {source.get('constant', 'as given')}"
    scale = f"times {source['scale']}" if "scale" in source else source.get("unit", "")
    return f"{signal} from '{source['column']}'" + (f" [{scale}]" if scale else "")


def _as_source(signal: str, source: Any, found: Mapping[str, Any]) -> Any:
    """Return what a mapping file would hold: the text of a column, or a number, is short for it.

    A column without a unit has the unit in its name, or that which its numbers were `found` to speak for.
    """
    if isinstance(source, str):
        source = {"column": source}
    if isinstance(source, Mapping):
        unit = split_unit(str(source.get("column", "")))[1]
        known = (
            {} if _has_unit(source) else {"unit": unit.text} if unit else _scaling(_same_column(source, found, signal))
        )
        return {**source, **known}
    if signal == "rate":
        return source
    try:
        return {"constant": float(source)}
    except (TypeError, ValueError):
        kind = type(source).__name__
        raise CesError(f"columns: {signal} is a {kind}; expected a name, a number or a mapping") from None


def to_frame(recording: Recording) -> Any:
    """Return a recording as a pandas DataFrame on the position's times [s] from its first one, the index.

    Columns are `position_m`, `current_A`, `force_N` and the like, whatever their times were: currents and temperatures
    are held, others interpolated, NaN in gaps. Raises CesError without pandas.
    """
    pandas = import_pandas()
    table = tabulate(recording, {})
    named = zip([*recording.channels, *recording.constants], table.columns, strict=True)
    columns = [DataColumn.of(signal, c.unit, np.where(c.missing, np.nan, c.values)) for signal, c in named]
    values = {column.name: column.values for column in columns}
    return pandas.DataFrame(values, index=pandas.Index(1e-9 * table.time_ns, name="time_s"))


def _scaling(source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the unit of what was found, without a turned sign: who names a column means it as it is."""
    scale = {"scale": abs(source["scale"])} if "scale" in source and not source.get("offset") else {}
    return {key: source[key] for key in ("unit",) if key in source} or scale


def import_pandas() -> Any:
    """Return pandas; raises CesError that says how to install it."""
    try:
        import pandas
    except ImportError:
        raise CesError("a DataFrame needs pandas: pip install 'ces_observer[frames]'") from None
    return pandas


def import_pyplot() -> Any:
    """Return matplotlib's pyplot; raises CesError that says how to install it."""
    try:
        from matplotlib import pyplot
    except ImportError:
        raise CesError("a plot needs matplotlib: pip install 'ces_observer[notebook]'") from None
    return pyplot
