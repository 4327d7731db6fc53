"""A recording as scripts and notebooks use it: from files and tables, cut, resampled, shown, written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ces_data import recording
from ces_data.bags.find import find_bag
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.limits import TableLimits
from ces_data.log_formats import is_log
from ces_data.logs.frame import TIMES
from ces_data.reading import (
    SIGNALS,
    PathInput,
    as_path,
    check_table,
    kind_of,
    read_frame,
    read_log,
    read_recording,
    to_frame,
)
from ces_data.recording import Channel
from ces_data.samples import channel_stats
from ces_data.signals_file import load_signals
from ces_data.tables import HELD, hold, interpolate
from ces_observer.errors import CesError, RecordingError, Suggesting
from ces_report.table import Column, Table
from ces_report.typesetting import format_alike

MAX_RATE_HZ = 1e6  # [Hz] a stamp is a whole number of ns
MAX_TIME_S = 8e9  # [s] beyond it, a stamp would not fit 64 bits
TABLES = (".csv", ".txt", ".parquet", ".json", ".mat", ".xlsx")  # that no bag is
NO_NUMBERS = "USTc"  # kinds of arrays of text and of complex numbers
EPOCH_NS = 10**18  # stamps of recordings made of arrays count from here


SHOWN = (
    "channel", "channels", "constants", "day", "duration_s", "from_arrays", "from_frame", "load", "name", "part",
    "resample", "save", "to_frame",
)  # fmt: skip  # what docs/api.md says, and plain facts


@dataclass(frozen=True, repr=False, eq=False)
class Recording(Suggesting, recording.Recording):
    """The channels of one experiment by signal name, each with its own stamps; `len` is its position samples.

    recording = Recording.load("bags/road").part(10, 20)
    recording.to_frame().plot(subplots=True)
    """

    def __new__(cls, *args: Any, **fields: Any) -> Self:
        """Return a new one; raises CesError for a path or a table alone."""
        if len(args) + len(fields) == 1 and args:
            raise CesError(
                "a Recording is read by Recording.load(path), Recording.from_frame(table) or .from_arrays(...)"
            )
        return super().__new__(cls)

    @classmethod
    def load(
        cls,
        path: PathInput,
        *,
        signals: PathInput | None = None,
        mapping: PathInput | None = None,
        columns: Mapping[str, Any] | None = None,
    ) -> Recording:
        """Read a bag (with a signals file) or a log (with a mapping file, or `columns`; else its columns are found).

        A measured force may be missing. Warns of what looks wrong; raises CesError for what cannot be used.
        """
        path = find_bag(str(as_path(path, "recording")))
        if mapping is not None or columns is not None or is_log(path):
            return with_methods(read_log(path, mapping=mapping, columns=columns, need=SIGNALS[:2]))
        return with_methods(read_recording(path, signals=signals, need=SIGNALS[:2]))

    @classmethod
    def from_frame(cls, table: Any, *, columns: Mapping[str, Any] | None = None, name: str = "") -> Recording:
        """Return the recording in a pandas DataFrame or a mapping of arrays.

        Time (column or index), position, current and force are found by name, unit and numbers, as `ces import` does,
        or named: `columns={"position": {"column": "x", "unit": "mm"}, "current": 0.5}`. Raises CesError.
        """
        return with_methods(check_table(read_frame(table, columns=columns, need=SIGNALS[:2], name=name)))

    @classmethod
    def from_arrays(
        cls,
        time_s: ArrayLike,
        position_m: ArrayLike,
        current_A: ArrayLike,
        force_N: ArrayLike | None = None,
        *,
        name: str = "",
    ) -> Recording:
        """Return a recording of arrays of shape (n,) in SI units, of which all but the time may be one number.

        Times are seconds, dates or durations. Raises CesError.
        """
        stamps = _as_stamps(time_s)
        if (np.diff(stamps) < 0).any():
            row = int(np.argmax(np.diff(stamps) < 0)) + 1
            before, after = 1e-9 * (stamps[row - 1 : row + 1] - stamps[0])
            raise RecordingError(
                f"time_s: runs backwards in row {row}, from {before:g} s to {after:g} s after its start"
            )
        given = {"position": ("m", position_m), "current": ("A", current_A), "force": ("N", force_N)}
        channels = {
            signal: Channel(signal, unit, stamps, _as_numbers(signal, values, len(stamps)))
            for signal, (unit, values) in given.items()
            if values is not None
        }
        if not isinstance(name, str):
            raise CesError(f"name: expected text; got {name!r}")
        if len(stamps) < TableLimits.MIN_SAMPLES:
            raise RecordingError(f"time_s: has {len(stamps)} values; expected at least {TableLimits.MIN_SAMPLES}")
        return with_methods(check_table(cls(name or "recording", channels)))

    def __dir__(self) -> list[str]:
        return [*SHOWN, *(name for name in super().__dir__() if name.startswith("_"))]

    def __len__(self) -> int:
        return len(self.channels["position"]) if "position" in self.channels else 0

    def to_frame(self) -> Any:
        """Return a DataFrame of `position_m`, `current_A`, `force_N` on the position's times [s], from 0.

        Currents at other times are held, forces interpolated; NaN in gaps.
        """
        return to_frame(self)

    def resample(self, rate_Hz: float) -> Self:
        """Return the recording with all channels on even times: currents held, others interpolated, no gap bridged."""
        if not isinstance(rate_Hz, int | float | np.number) or not 0.0 < rate_Hz <= MAX_RATE_HZ:
            raise RecordingError(f"resample({rate_Hz!r}): expected a rate above 0, up to {MAX_RATE_HZ:g} Hz")
        position = self.channel("position").in_order()
        count = int(np.floor(np.ptp(position.stamps_ns) * 1e-9 * rate_Hz)) + 1
        stamps = position.stamps_ns[0] + np.rint(np.arange(count) * (1e9 / rate_Hz)).astype(np.int64)
        channels = {}
        for name, channel in self.channels.items():
            values, missing = (hold if name in HELD else interpolate)(channel.in_order(), stamps)
            channels[name] = replace(channel, stamps_ns=stamps, values=values).select(~missing)
        return replace(self, channels=channels, sha256="")

    def save(self, path: PathInput, *, overwrite: bool = False) -> None:
        """Write a rosbag2 folder with the topics of the packaged signals file. Raises CesError."""
        target = as_path(path, "path")
        if target.suffix.lower() in TABLES:
            raise CesError(
                f"{target}: a recording is saved as a bag, a folder; a table is written by to_frame().to_csv(...)"
            )
        write_bag(target, recording_topics(self, load_signals()), overwrite=overwrite)

    def __repr__(self) -> str:
        taken = f"\n{self.taken}" if self.taken else ""
        return f"{self._describe()}{taken}\n{self._table()}"

    def _repr_html_(self) -> str:
        taken = Markup("<br>{}").format(self.taken) if self.taken else ""
        return str(Markup("<p>{}{}</p>{}").format(self._describe(), taken, self._table().to_html()))

    def _describe(self) -> str:
        constants = "".join(f", {name} {value:g}" for name, value in self.constants.items())
        return f"Recording {self.name}: {self.duration_s:.3f} s{constants}"

    def _table(self) -> Table[Channel]:
        def limits(c: Channel) -> str:
            stats = channel_stats(c)
            return " to ".join(format_alike(dict.fromkeys((stats.low, stats.high)))) if len(c) else "-"

        columns: list[Column[Channel]] = [
            Column("Signal", lambda c: c.name),
            Column("Unit", lambda c: c.unit),
            Column("Samples", lambda c: str(len(c)), figure=True),
            Column("Rate [Hz]", lambda c: f"{channel_stats(c).rate_Hz:.4g}", figure=True),
            Column("Range", limits, figure=True),
        ]
        return Table(columns, list(self.channels.values()))


def with_methods(given: recording.Recording) -> Recording:
    """Return the same recording with the methods of scripts."""
    if isinstance(given, Recording):
        return given
    return Recording(**{f.name: getattr(given, f.name) for f in fields(given)})


def _as_stamps(time_s: ArrayLike) -> recording.Stamps:
    """Return times [ns] (n,) of seconds, dates or durations. Raises CesError."""
    given = np.asarray(time_s)
    if given.dtype.kind in TIMES:
        if np.isnat(given).any():
            raise RecordingError(f"time_s: is missing in row {int(np.isnat(given).argmax())}; expected a time")
        from_ns = EPOCH_NS if given.dtype.kind == "m" else 0
        return from_ns + given.astype(f"{given.dtype.kind}8[ns]").astype(np.int64)
    time = _as_numbers("time_s", time_s)
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise RecordingError(f"time_s: is {time[row]} in row {row}; expected seconds")
    if np.abs(time).max(initial=0.0) > MAX_TIME_S:
        raise RecordingError(f"time_s: reaches {np.abs(time).max():.4g}; expected seconds (divide nanoseconds by 1e9)")
    return EPOCH_NS + np.rint(time * 1e9).astype(np.int64)


def _as_numbers(name: str, values: ArrayLike, count: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return an array (n,) of numbers; one number fills `count` rows. Raises CesError."""
    try:
        given = np.asarray(values)
        if given.dtype.kind in NO_NUMBERS or (given.dtype.kind == "O" and any(isinstance(v, str) for v in given.flat)):
            raise TypeError
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CesError(f"{name}: expected an array of numbers; got {kind_of(values)}") from None
    array = np.full(count, float(array)) if count and not array.ndim else array
    if array.ndim != 1:
        raise CesError(f"{name}: has shape {array.shape}; expected (n,)")
    if count and len(array) != count:
        raise CesError(f"{name}: has {len(array)} values for {count} times; expected as many, or one number")
    return array
