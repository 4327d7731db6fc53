"""A recording: the channels of one experiment as they were logged, each with its own time stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ces_observer.errors import RecordingError

Stamps = NDArray[np.int64]
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Channel:
    """One logged signal in SI units.

    `stamps_ns` int64 and `values` float64, both of shape (n,). Stamps are kept as logged: they may repeat or run
    backwards, and values may be NaN; preparation decides what to do about it.
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
        object.__setattr__(self, "stamps_ns", _frozen(stamps))
        object.__setattr__(self, "values", _frozen(values))

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def select(self, mask: NDArray[np.bool_]) -> Channel:
        """Return the samples (n,) marked."""
        return replace(self, stamps_ns=self.stamps_ns[mask], values=self.values[mask])


@dataclass(frozen=True)
class Recording:
    """The channels of one experiment by signal name, with where they came from.

    `source` is the path as given, `sha256` the hash of the file's (or, for a directory, its data files') bytes;
    both empty for a recording made in memory. `constants` holds signals known without a channel.
    """

    name: str
    channels: Mapping[str, Channel]
    constants: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    sha256: str = ""

    def __contains__(self, signal: str) -> bool:
        return signal in self.channels or signal in self.constants

    def channel(self, signal: str) -> Channel:
        """Return the channel of `signal`; raises RecordingError naming the channels there are."""
        if signal not in self.channels:
            raise RecordingError(f"{self.name}: no '{signal}' channel; it has {', '.join(self.channels) or 'none'}")
        return self.channels[signal]

    def first_part(self, share: float) -> Recording:
        """Return what was logged up to the first `share` of the position samples."""
        stamps = self.channel("position").stamps_ns
        end = stamps[min(len(stamps) - 1, round(share * len(stamps)))] if share < 1.0 else None
        if end is None:
            return self
        kept = {n: c.select(c.stamps_ns < end) for n, c in self.channels.items()}
        return replace(self, channels=kept)


def _frozen(array: NDArray[np.generic]) -> NDArray[np.generic]:
    view = array.view()
    view.flags.writeable = False
    return view
