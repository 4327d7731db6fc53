"""A recording: the channels of one experiment as they were logged, each with its own time stamps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from math import inf
from numbers import Real
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ces_observer.errors import RecordingError

CALENDAR_NS = 1_009_843_200_000_000_000  # 2002-01-01 UTC: what counts from zero begins before it, or at 10**18

Stamps = NDArray[np.int64]
Values = NDArray[np.float64]
MAX_S = 1e9  # [s] longer than any recording
MIN_SAMPLES = 2  # of a position, to be a motion


@dataclass(frozen=True, repr=False)
class Channel:
    """One logged signal in SI units: `stamps_ns` int64 and `values` float64, both of shape (n,).

    Stamps are kept as logged and may repeat or run backwards; values may be NaN. Preparation handles both.
    """

    name: str
    unit: str
    stamps_ns: Stamps
    values: Values

    def __post_init__(self) -> None:
        stamps = np.asarray(self.stamps_ns, dtype=np.int64)
        values = np.asarray(self.values, dtype=np.float64)
        if stamps.ndim != 1 or stamps.shape != values.shape:
            raise RecordingError(
                f"channel '{self.name}': {stamps.shape} stamps and {values.shape} values; expected two equal lengths"
            )
        for name, view in (("stamps_ns", stamps.view()), ("values", values.view())):
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    def __repr__(self) -> str:
        return f"Channel {self.name} [{self.unit}]: stamps_ns and values of {len(self)} samples"

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def select(self, mask: NDArray[np.bool_]) -> Channel:
        """Return the samples where `mask` (n,) is true; those of one run are not copied."""
        count = int(np.count_nonzero(mask))
        run = slice(first := int(np.argmax(mask)) if count else 0, first + count)
        part = run if mask[run].all() else mask
        return replace(self, stamps_ns=self.stamps_ns[part], values=self.values[part])

    def finite(self) -> Channel:
        """Return the samples with finite values."""
        return self.select(np.isfinite(self.values))

    def in_order(self) -> Channel:
        """Return the finite samples in the order of time, the first of each stamp."""
        finite = self.finite()
        stamps, places = np.unique(finite.stamps_ns, return_index=True)
        return replace(finite, stamps_ns=stamps, values=finite.values[places])


@dataclass(frozen=True, eq=False)
class Recording:
    """The channels of one experiment by signal name, and their origin.

    `source` is the path, `sha256` the hash of the bytes of the file or of the folder's data files; both are empty for a
    recording made in memory. `constants` holds signals that are known without a channel. `optional` are the channels
    that a model uses only if it is asked to, such as the speed in a log with a position. `taken` says which column was
    read as what, where that was found by name, unit and numbers.
    """

    name: str
    channels: Mapping[str, Channel]
    constants: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    sha256: str = ""
    optional: frozenset[str] = frozenset()
    taken: str = ""

    @classmethod
    def join(cls, blocks: Sequence[Recording]) -> Recording:
        """Return the recording whose channels are those of successive blocks."""
        first, *others = blocks
        channels = {}
        for name, channel in first.channels.items() if others else ():
            parts = [block.channels[name] for block in blocks]
            stamps, values = (np.concatenate([getattr(p, key) for p in parts]) for key in ("stamps_ns", "values"))
            channels[name] = replace(channel, stamps_ns=stamps, values=values)
        return replace(first, channels=channels) if others else first

    def __contains__(self, signal: str) -> bool:
        return signal in self.channels or signal in self.constants

    def channel(self, signal: str) -> Channel:
        """Return the channel of `signal`; raises RecordingError naming the recording's channels."""
        if signal not in self.channels:
            raise RecordingError(f"{self.name}: no '{signal}' channel; it has {', '.join(self.channels) or 'none'}")
        return self.channels[signal]

    @property
    def day(self) -> str:
        """The day (UTC) of the first sample, such as 2026-05-03; '' if the clock knew no calendar."""
        first_ns = min((int(c.stamps_ns.min()) for c in self.channels.values() if len(c)), default=0)
        return f"{datetime.fromtimestamp(1e-9 * first_ns, UTC):%Y-%m-%d}" if first_ns >= CALENDAR_NS else ""

    @property
    def duration_s(self) -> float:
        """Time [s] from the first to the last position sample."""
        stamps = self.channels["position"].stamps_ns if "position" in self.channels else ()
        return float(np.ptp(stamps)) * 1e-9 if len(stamps) else 0.0

    def part(self, from_s: float = 0.0, to_s: float = inf) -> Self:
        """Return the samples from `from_s` up to `to_s` after the first position sample. Raises RecordingError."""
        if not all(isinstance(end, Real) for end in (from_s, to_s)) or not 0.0 <= from_s < to_s:
            raise RecordingError(f"{self.name}: no part from {from_s!r} s to {to_s!r} s; expected 0 <= from < to")
        if from_s > self.duration_s:
            raise RecordingError(
                f"{self.name}: no part from {from_s:g} s to {to_s:g} s; it has {self.duration_s:.3f} s"
            )
        if from_s == 0.0 and to_s > self.duration_s:
            return self
        begin, span = int(self.channel("position").stamps_ns.min()), f"{from_s:g}-{min(to_s, self.duration_s):.3g} s"
        taken = self.between(begin + _to_ns(from_s), begin + _to_ns(to_s))
        if (count := len(taken.channels["position"])) < MIN_SAMPLES:
            holds = f"holds {count} position samples; expected at least {MIN_SAMPLES}"
            raise RecordingError(f"{self.name}: the part from {from_s:g} s to {to_s:g} s {holds}")
        return replace(taken, name=f"{self.name} {span}", sha256="")

    def between(self, start_ns: int, stop_ns: int) -> Self:
        """Return the samples with stamps from `start_ns` up to `stop_ns`."""
        inside = {name: (c.stamps_ns >= start_ns) & (c.stamps_ns < stop_ns) for name, c in self.channels.items()}
        return replace(self, channels={name: c.select(inside[name]) for name, c in self.channels.items()})

    def share(self, first: float, last: float) -> Self:
        """Return the recording from the share `first` to the share `last` of the position samples."""
        if first <= 0.0 and last >= 1.0:
            return self
        stamps = self.channel("position").stamps_ns
        begin, end = (stamps[min(len(stamps) - 1, round(share * len(stamps)))] for share in (first, last))
        channels = {
            name: c.select(((c.stamps_ns >= begin) | (first <= 0.0)) & ((c.stamps_ns < end) | (last >= 1.0)))
            for name, c in self.channels.items()
        }
        return replace(self, channels=channels)


def _to_ns(time_s: float) -> int:
    """Return seconds after the start of a recording as whole nanoseconds."""
    return round(1e9 * min(time_s, MAX_S))


def describe_days(recordings: Iterable[Recording]) -> str:
    """Return the days on which recordings were made, from the first to the last; '' if no clock knew them."""
    return join_days(recording.day for recording in recordings)


def join_days(days: Iterable[str]) -> str:
    """Return the first and the last of some days, `2026-05-03 to 2026-05-07`."""
    known = sorted({*days} - {""})
    return " to ".join(dict.fromkeys((known[0], known[-1]))) if known else ""
