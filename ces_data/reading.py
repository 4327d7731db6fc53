"""Recordings from what a user gives: recordings, or the paths of bags and logs, one or several."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from ces_data.bags import reader
from ces_data.bags.find import find_bags
from ces_data.checks.motion import recorded_motion
from ces_data.checks.units import unit_findings
from ces_data.findings import require_usable, warn
from ces_data.frames import is_table, read_columns, read_frame, warn_of_signs
from ces_data.log_formats import is_log
from ces_data.logs import log_import
from ces_data.logs.log_file import open_log
from ces_data.logs.log_mapping import DynoMapping, load_dyno_mapping
from ces_data.mapping.proposals import propose_mapping, split_damper
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError

SIGNALS = ("position", "current", "force")
EXPECTED = {"model": "a model or ", "simulation": "a model, a function or "}  # beside paths, by kind
IN_FILES = {
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
    if hasattr(given, "dtype") and not is_table(given):
        advice = "name its columns, {'time_s': X[:, 0], ...}, or take ces.DamperModel().fit(X, y)"
        raise CesError(f"{called}: expected a recording, a path, a table, or several; got an array: {advice}")
    if not single and not hasattr(given, "__iter__"):
        raise CesError(f"{called}: expected a recording, a path, a table, or several; got {kind_of(given)}")
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
            raise CesError(f"{called}: expected a recording, a path, a table, or several; got {kind_of(one)}")
        else:
            recordings += [_read(path, signals, need) for path in find_bags([as_path(one, "recording")])]
    return recordings


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
    return Path(given)


def kind_of(given: object) -> str:
    """Return what a value is, for an error."""
    return "None" if given is None else f"a value of type {type(given).__name__}"


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
