"""Equal content of recordings: the same recording under another path or name, or parts of one recording.

Time is compared together with values: logs that were imported start at 0, and two dampers may be recorded at once.
Marks are hashes of short runs of the force; a run of measured values does not occur twice. The same marks appear in
every copy and part of a recording, however it was stored, so that those in a model's file show what it was identified
on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_data.limits import ContentLimits, StatisticLimits
from ces_data.recording import Channel, Recording
from ces_observer.errors import RecordingError

U = NDArray[np.uint64]
MARK = re.compile(r"[0-9a-f]{16}")

COMPARED = ("position", "force")  # both must be equal: two dampers may share a stroke
RUN = 32  # samples of a run
MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
MARKS = 64  # in a model's file, of each recording
SPARSE = np.uint64(32)  # of all marks, one in so many serves to find a shift


@dataclass(frozen=True)
class SharedContent:
    """The part that two recordings have in common: everything, or `seconds`."""

    whole: bool
    seconds: float

    def __str__(self) -> str:
        return "the same recording" if self.whole else f"share {self.seconds:.1f} s of one recording"


def shared_content(recording: Recording, other: Recording) -> SharedContent | None:
    """Return what two recordings have in common, None if they are different recordings."""
    both = [name for name in COMPARED if name in recording.channels and name in other.channels]
    pairs = [(recording.channels[name], other.channels[name]) for name in both]
    if not pairs or not all(len(a) and len(b) for a, b in pairs):
        return None
    if all(len(a) == len(b) and np.allclose(a.values, b.values, 0.0, _tolerance(a), True) for a, b in pairs):
        return SharedContent(True, 0.0)
    seconds = 0.0
    for a, b in reversed(pairs):  # the force first: it settles most pairs
        one_line, other_line = a.finite(), b.finite()
        seconds = max(
            _seconds_on_line(one_line, other_line, shift_ns) or _seconds_on_line(other_line, one_line, -shift_ns)
            for shift_ns in _possible_shifts(a, b)  # the copy may be the denser one
        )
        if not seconds:
            return None
    return SharedContent(False, seconds)


def require_distinct(identification: Sequence[Recording], validation: Sequence[Recording] = ()) -> None:
    """Raise RecordingError if a recording is given twice, or if validation recordings were given for identification."""
    require_once(identification, ", twice for identification")
    for recording in identification:
        for other in validation:
            if shared := shared_content(recording, other):
                text = f"{shared}, for identification and for validation: that validates nothing"
                remedy = "give another recording, or leave it out of one of the two"
                raise RecordingError(f"{_names(recording, other)}: {text}; {remedy}")


def require_once(recordings: Sequence[Recording], use: str = "") -> None:
    """Raise RecordingError if two recordings for one use have seconds in common."""
    for pair in combinations(recordings, 2):
        if shared := shared_content(*pair):
            raise RecordingError(f"{_names(*pair)}: {shared}{use}: its seconds would count twice; give it once")


def select_new(recordings: Sequence[Recording], known: Sequence[Recording]) -> list[Recording]:
    """Return those that are not known. Raises RecordingError for one that has a part of a known one, or of another."""
    new = list[Recording]()
    for recording in recordings:
        shared = [(other, shared_content(recording, other)) for other in known]
        if any(content is not None and content.whole for _, content in shared):
            continue
        for other, content in shared:
            if content is not None:
                require_once([recording, other])
        new.append(recording)
    return new


def recording_marks(recording: Recording) -> list[str]:
    """Return marks of a recording for a model's file: up to MARKS hashes of runs of the force, spread over its time."""
    marks = np.sort(_all_marks(recording.channels.get("force")))
    return [f"{int(mark):016x}" for mark in marks[:MARKS]]


def marks_of_copies(recording: Recording) -> list[str]:
    """Return the marks of a recording, and of its force at the position's stamps, as in a table (ces export-data)."""
    if not {"position", "force"} <= recording.channels.keys():
        return recording_marks(recording)
    stamps, force = recording.channels["position"].stamps_ns, recording.channels["force"]
    force = force.finite()
    if np.array_equal(stamps, force.stamps_ns) or len(force) < RUN:
        return recording_marks(recording)
    inside = stamps[(stamps >= force.stamps_ns[0]) & (stamps <= force.stamps_ns[-1])]
    at, logged = ((s - force.stamps_ns[0]).astype(np.float64) for s in (inside, force.stamps_ns))
    in_table = Channel(force.name, force.unit, inside, np.interp(at, logged, force.values))
    as_table = replace(recording, channels={**recording.channels, "force": in_table})
    return [*recording_marks(recording), *recording_marks(as_table)]


def known_share(recording: Recording, marks: Sequence[str]) -> float:
    """Return the share of `marks` that a recording holds: about that of the marked seconds that are part of it."""
    if not marks:
        return 0.0
    known_marks = np.array([int(mark, 16) for mark in marks], np.uint64)
    return float(np.isin(known_marks, _all_marks(recording.channels.get("force"))).mean())


def find_known_recording(recording: Recording, provenance: Mapping[str, Any]) -> str:
    """Return the name of a recording that a model was identified on and that holds seconds of this one, else nothing.

    `provenance` is the model's. The marks show copies and parts; the hash of the bag's bytes decides for older model
    files, and for models of a teacher's force.
    """
    for row in identification_rows(provenance):
        stored, digest = row.get("marks"), row.get("sha256")
        words = stored.split() if isinstance(stored, str) else []
        same = isinstance(digest, str) and bool(digest) and digest == recording.sha256
        if same or known_share(recording, [word for word in words if MARK.fullmatch(word)]) > 0.0:
            return str(row.get("recording", recording.name))
    return ""


def identification_rows(provenance: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the rows of the recordings that a model was identified on."""
    rows = provenance.get("identification")
    yield from (row for row in rows if isinstance(row, Mapping)) if isinstance(rows, list) else ()


def _names(recording: Recording, other: Recording) -> str:
    first, second = ((r.source or r.name) for r in (recording, other))
    return first if first == second else f"{first} and {second}"


def _tolerance(channel: Channel) -> float:
    """Return the difference that re-encoding may make."""
    finite = channel.values[np.isfinite(channel.values)]
    return ContentLimits.EQUAL * float(np.ptp(finite)) if len(finite) else 0.0


def _possible_shifts(a: Channel, b: Channel) -> Iterator[int]:
    """Yield by how much [ns] the stamps of `b` may be shifted: not at all, or so that equal runs coincide."""
    yield 0
    (marks, stamps_ns), (others, other_ns) = _marks_with_stamps(a), _marks_with_stamps(b)
    common, rows, columns = np.intersect1d(marks, others, return_indices=True)
    if len(common):
        yield int(np.median(stamps_ns[rows] - other_ns[columns]))


def _marks_with_stamps(channel: Channel) -> tuple[U, NDArray[np.int64]]:
    """Return every SPARSE-th mark that is unique in the channel, and the stamps of their runs."""
    marks, informative = _run_hashes(channel)
    kept = np.flatnonzero(informative & (marks % SPARSE == 0))
    unique, first, count = np.unique(marks[kept], return_index=True, return_counts=True)
    once = count == 1
    return unique[once], channel.stamps_ns[np.isfinite(channel.values)][kept[first[once]]]


def _all_marks(channel: Channel | None) -> U:
    if channel is None:
        return np.empty(0, np.uint64)
    marks, informative = _run_hashes(channel)
    unique, count = np.unique(marks[informative], return_counts=True)
    return np.asarray(unique[count == 1])


def _run_hashes(channel: Channel) -> tuple[U, NDArray[np.bool_]]:
    """Return a hash for each run of RUN finite values, as of single precision, and whether the run is informative."""
    values = channel.values[np.isfinite(channel.values)].astype(np.float32) + np.float32(0.0)
    count = len(values) - RUN + 1
    if count < 1:
        return np.empty(0, np.uint64), np.empty(0, np.bool_)
    bits = values.view(np.uint32).astype(np.uint64) * MULTIPLIER
    bits ^= bits >> np.uint64(29)
    marks = np.zeros(count, np.uint64)
    for k in range(RUN):
        marks = (marks ^ (marks >> np.uint64(31))) * MULTIPLIER + bits[k : k + count]
    marks ^= marks >> np.uint64(32)
    runs = np.sort(np.lib.stride_tricks.sliding_window_view(values, RUN)[:: RUN // 2], axis=1)
    distinct = 1 + np.count_nonzero(np.diff(runs, axis=1), axis=1)
    return marks, np.repeat(distinct >= ContentLimits.MIN_DISTINCT, RUN // 2)[:count]


def _seconds_on_line(samples: Channel, line: Channel, shift_ns: int) -> float:
    """Return the seconds in which `samples` lie on the straight lines between those of `line`, shifted in time."""
    stamps = line.stamps_ns + shift_ns
    inside = (samples.stamps_ns >= stamps.min()) & (samples.stamps_ns <= stamps.max())
    if inside.sum() < StatisticLimits.ENOUGH or len(np.unique(samples.values[inside])) < ContentLimits.MIN_DISTINCT:
        return 0.0
    origin = int(stamps[0])
    at = (samples.stamps_ns[inside] - origin).astype(np.float64)
    other = np.interp(at, (stamps - origin).astype(np.float64), line.values)
    equal = np.abs(samples.values[inside] - other) <= max(_tolerance(samples), _tolerance(line))
    return float(np.ptp(at)) * 1e-9 if equal.mean() >= ContentLimits.SAME_SHARE else 0.0
