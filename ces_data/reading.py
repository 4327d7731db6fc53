"""Recordings from what a user gives: recordings, tables in memory, the paths of bags and logs, one or several.

Columns and units of a table are found as those of a log are; `to_frame` gives a recording back as a table.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import yaml

from ces_data.bags import reader
from ces_data.bags.find import find_bags
from ces_data.checks.motion import recorded_motion
from ces_data.checks.units import unit_findings
from ces_data.findings import require_usable, warn
from ces_data.limits import TableLimits
from ces_data.log_formats import is_log
from ces_data.logs import log_import
from ces_data.logs.csv_form import find_other_unit
from ces_data.logs.frame import FrameTable, is_frame
from ces_data.logs.log_file import LogTable, TimedLog, open_log
from ces_data.logs.log_import import to_recording
from ces_data.logs.log_mapping import DynoMapping, load_dyno_mapping, parse_mapping_without_force
from ces_data.mapping.doubts import BY_FRAME, BY_SCRIPT, NOT_READ
from ces_data.mapping.proposals import MappingProposal, propose_for, propose_mapping, split_damper
from ces_data.mapping.rating import GUESSED
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
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
    rate = columns.get("rate")
    if isinstance(rate, str) and rate not in names:
        raise CesError(f"columns: rate is {rate!r}; expected a number [Hz], or the name of a column")
    name = str(log.path)
    proposal = propose_for(log, need=need)
    found = yaml.safe_load(proposal.text) or {}
    given = {signal: _as_source(signal, source, found) for signal, source in columns.items()}
    content = {**found, **given}
    if "rate" in given and "time" not in given and (time := content.pop("time", None)):
        _warn_of_rate(name, rate, time["column"], proposal)
    settled = {*given, *({"time"} if "rate" in given else ())}
    named = [s for s in given if s != "rate" and not _has_unit(columns[s]) and _same_column(given[s], found, s)]
    guessed = tuple(f"{signal}: {GUESSED}" for signal in named)
    doubts = [text for text in proposal.doubts if text.partition(":")[0] not in settled or text.startswith(guessed)]
    if doubts:
        where = BY_FRAME if isinstance(log, FrameTable) else BY_SCRIPT
        raise RecordingError(f"{name}: ", proposal.tell(doubts, where=where))
    for remark in (text for text in proposal.remarks if text.partition(":")[0] not in settled):
        warn(f"{name}: {remark}")
    taken = [text for text in proposal.found if text.partition(" ")[0] not in settled]
    taken += [_describe_given(signal, source) for signal, source in given.items() if isinstance(source, Mapping)]
    taken += [text for text in proposal.remarks if text.endswith(NOT_READ)]
    recording = replace(to_recording(log, parse_mapping_without_force(content, name)), taken=", ".join(taken))
    return warn_of_signs(recording)


def _warn_of_rate(name: str, rate: Any, column: str | int, proposal: MappingProposal) -> None:
    """Warn of a given rate [Hz] that the times, whose place it takes, contradict."""
    choices = [choice for damper in proposal.selection.dampers.values() for choice in damper.choices.values()]
    rate_Hz = choices[0].candidate.rate_Hz if choices else 0.0
    if isinstance(rate, int | float) and rate_Hz and abs(rate / rate_Hz - 1.0) > TableLimits.RATE_TOLERANCE:
        warn(f"{name}: rate: {rate:g} Hz takes the place of the times in {column!r}, which give {rate_Hz:.4g} Hz")


def warn_of_signs(recording: Recording) -> Recording:
    """Return the recording; warn of a column that was turned, against which scripts would compare a simulated force."""
    for signal, column in TURNED.findall(recording.taken):
        text = f"'{column}' is read with its sign turned; every force that comes back is positive in compression"
        warn(f"{recording.name}: {signal}: {text}: negate one of the two to compare them")
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
    if signal == "time" and not isinstance(source, str | Mapping):
        raise CesError(f"columns: time is {source!r}; expected the name of a column, or {{'column': 0}} for the first")
    if isinstance(source, str):
        source = {"column": source}
    if isinstance(source, Mapping):
        column = str(source.get("column", ""))
        unit = split_unit(column)[1]
        if signal in UNITS and not (unit or _has_unit(source)) and (other := find_other_unit(column)):
            per = {"column": column, "scale": f"{UNITS[signal]} per {other}"}
            raise CesError(
                f"columns: {signal}: '{column}' is in {other}; give its scale: columns={{'{signal}': {per}}}"
            )
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


SIGNALS = ("position", "current", "force")
EXPECTED = {"model": "a model or ", "simulation": "a model, a function or "}  # beside paths, by kind
IN_FILES = {
    "the key delay (default 0) of ": "the delay (in from_frame's columns={...}, default 0) of ",
    "set scale: -1 in the signals file of": "multiply by -1",
    "set its scale in the signals file": "scale it",
    "its scale in the signals file": "it",
    "the scale of time in the mapping file": "time",
    "the scale of ": "",
    " in the signals file": "",
    " in the mapping file": "",
}
PathInput: TypeAlias = "str | os.PathLike[str]"
RecordingInput: TypeAlias = "Recording | PathInput | Mapping[str, Any]"  # or a pandas DataFrame
RecordingInputs: TypeAlias = "RecordingInput | Sequence[RecordingInput]"


def read_recording(path: PathInput, *, signals: PathInput | None = None, need: Sequence[str] = SIGNALS) -> Recording:
    """Read and check a rosbag2 folder or `.mcap` file; `signals` is a signals file (default: the packaged one).

    Each signal in `need` must be there. Warns of what looks wrong; raises CesError for what cannot be used.
    """
    described = load_signals(None if signals is None else as_path(signals, "signals"))
    return _check(reader.read_recording(as_path(path, "recording"), described, need))


def read_log(
    path: PathInput,
    *,
    mapping: PathInput | None = None,
    columns: Mapping[str, Any] | None = None,
    need: Sequence[str] = SIGNALS,
    say: Callable[[str], None] = lambda found: None,
    take: Callable[[Recording], Recording] = lambda whole: whole,
) -> Recording:
    """Read and check a log of any format that `ces import` reads.

    `mapping` is its mapping file, `columns` those of `read_frame`. Without, columns are found by names, units and
    numbers, as `ces import` does, and `say` is told what was taken; what `take` leaves of it is checked. A force that
    is not in `need` may be missing. Raises CesError, also where what was found is not certain.
    """
    path = as_path(path, "log")
    if mapping is not None:
        return _check(_with_hash(log_import.import_log(path, load_dyno_mapping(as_path(mapping, "mapping"))), path))
    if columns is not None:
        log = open_log(path, DynoMapping(source="columns", signals={}, blank="missing"))
        return check_table(_with_hash(read_columns(log, columns, need), path))
    proposal = propose_mapping(path, need=need)
    recording = replace(_with_hash(proposal.read(), split_damper(path)[0]), taken=", ".join(proposal.found))
    say(recording.taken)
    for remark in proposal.remarks:
        warn(f"{path}: {remark}")
    return _check(take(recording))


def as_recordings(
    given: RecordingInputs,
    signals: PathInput | None = None,
    *,
    need: Sequence[str] = SIGNALS,
    required: bool = True,
    called: str = "recordings",
) -> list[Recording]:
    """Return recordings that were given as such, as tables, or as paths and globs of bags and logs, one or several.

    Recordings and tables may have names, as keys of a mapping. `signals` describes bags only. Errors say `called`.
    """
    single = _is_one(given)
    if not single and (is_array(given) or not hasattr(given, "__iter__")):
        raise _no_recording(called, given)
    if isinstance(given, Mapping) and given and all(map(_is_one, given.values())):
        return [r for name, one in given.items() for r in _as_named(str(name), one, signals, need)]
    several: Sequence[Any] = [given] if single else list(given)  # type: ignore[arg-type]
    if required and not several:
        raise CesError("no recording given; expected a recording, a path, or several of them")
    if signals is not None and not any(isinstance(one, str | os.PathLike) for one in several):
        raise CesError("signals: describes the topics of bags; there is none here")
    recordings: list[Recording] = []
    for number, one in enumerate(several, 1):
        if isinstance(one, Recording):
            if missing := next((signal for signal in need if signal not in one), ""):
                taken = f" (taken: {one.taken})" if one.taken else ""
                raise CesError(f"{one.name}: no {missing} was recorded, which is needed here{taken}")
            recordings.append(one)
        elif is_table(one):
            recordings.append(check_table(read_frame(one, need=need, number=number if len(several) > 1 else 0)))
        elif not isinstance(one, str | os.PathLike):
            raise _no_recording(called, one)
        else:
            recordings += [_read(path, signals, need) for path in find_bags([as_path(one, "recording")])]
    return _tell_apart(recordings)


def _tell_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings of which later ones of one name have a number behind it."""
    counts: Counter[str] = Counter()
    apart = []
    for recording in recordings:
        counts[recording.name] += 1
        number = counts[recording.name]
        apart.append(replace(recording, name=f"{recording.name} ({number})") if number > 1 else recording)
    return apart


def _no_recording(called: str, given: object) -> CesError:
    advice = ": name its columns, {'time_s': X[:, 0], ...}, or take ces.DamperModel().fit(X, y)" * is_array(given)
    return CesError(f"{called}: expected a recording, a path, a table, or several; got {kind_of(given)}{advice}")


def is_array(value: object) -> bool:
    """Return whether a value is an array, or a column of a table."""
    return hasattr(value, "dtype")


def _as_named(name: str, given: RecordingInput, signals: PathInput | None, need: Sequence[str]) -> list[Recording]:
    """Return what a mapping of recordings holds under a name."""
    if is_table(given):
        return [check_table(read_frame(given, need=need, name=name))]
    named = replace(given, name=name) if isinstance(given, Recording) else given
    return [replace(one, name=name) for one in as_recordings(named, signals, need=need)]


def _is_one(value: object) -> bool:
    """Return whether a value is a recording of any kind, and no column of a table."""
    return isinstance(value, Recording | str | os.PathLike) or is_table(value)


def _read(path: Path, signals: PathInput | None, need: Sequence[str]) -> Recording:
    if is_log(path):
        return warn_of_signs(read_log(path, need=need))
    return read_recording(path, signals=signals, need=need)


def as_path(given: PathInput, name: str, kind: str = "") -> Path:
    """Return a path; raises CesError if `given` is none, calling it `name`, of this `kind` in EXPECTED."""
    if not isinstance(given, str | os.PathLike):
        raise CesError(f"{name}: expected {EXPECTED.get(kind or name, '')}a path; got {kind_of(given)}")
    if not os.fspath(given):
        raise CesError(f"{name}: the path is empty")
    return Path(given).expanduser()


def kind_of(given: object) -> str:
    """Return what a value is, for an error."""
    return "None" if given is None else "an array" if is_array(given) else f"a value of type {type(given).__name__}"


def _with_hash(recording: Recording, path: Path) -> Recording:
    """Return a recording with the hash of its file, by which it is known again."""
    with path.open("rb") as file:
        return replace(recording, sha256=hashlib.file_digest(file, "sha256").hexdigest())


def check_table(recording: Recording) -> Recording:
    """Return a recording made of arrays that can be used; warns of what looks wrong, units too. Raises CesError."""
    for finding in unit_findings(_check(recording), recorded_motion(recording)):
        warn(f"{recording.name}: {describe_finding(finding.text)}")
    return recording


def describe_finding(text: str, recordings: Sequence[Recording] = ()) -> str:
    """Return the text of a finding; of tables, which have no signals file, the values are multiplied themselves."""
    if any(one.source and Path(one.source).exists() for one in recordings):
        return text
    for words, others in IN_FILES.items():
        text = text.replace(words, others)
    return text


def _check(recording: Recording) -> Recording:
    """Return a recording that can be used; warns of what looks wrong. Raises CesError."""
    for finding in require_usable(recording):
        warn(f"{recording.name}: {finding.text}")
    return recording
