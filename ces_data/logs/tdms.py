"""LabVIEW's TDMS files: channels with the times of their waveforms, or a table with a channel of times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.config_file import first_line
from ces_data.logs.frame import FrameTable
from ces_data.logs.log_file import LogSeries, LogTable, Progress, TimedLog, import_reader, join_names
from ces_data.logs.log_mapping import DynoMapping, LogColumn
from ces_observer.errors import RecordingError

STEP, OFFSET, START, UNIT = "wf_increment", "wf_start_offset", "wf_start_time", "unit_string"


def open_log(path: Path, _: DynoMapping, __: Progress) -> LogTable | TimedLog:
    """Open a TDMS file; raises RecordingError if it is damaged, holds no numbers, or nptdms is missing."""
    library = import_reader("nptdms", path)
    try:
        with library.TdmsFile.open(path) as file:
            channels = [channel for group in file.groups() for channel in group.channels() if len(channel)]
            names = _names(channels)
            numbers = {name: channel[:] for name, channel in zip(names, channels, strict=True)}
            facts = {name: dict(channel.properties) for name, channel in zip(names, channels, strict=True)}
    except OSError:
        raise
    except Exception as error:  # the library raises errors of any kind for a damaged file
        raise RecordingError(f"{path}: not a TDMS file, or damaged: {first_line(error)}") from None
    numbers = {name: values for name, values in numbers.items() if values.dtype.kind in "biufM"}
    if not numbers:
        raise RecordingError(f"{path}: holds no channel of numbers")
    timed = {name: values for name, values in numbers.items() if float(facts[name].get(STEP) or 0.0) > 0.0}
    return Waveforms(path, timed, facts) if timed else ChannelTable(path, numbers, facts)


def _names(channels: Sequence[Any]) -> list[str]:
    """Return the names of channels, those that several groups have after their group's."""
    plain = [str(channel.name) for channel in channels]
    pairs = zip(plain, channels, strict=True)
    return [f"{channel.group_name}/{name}" if plain.count(name) > 1 else name for name, channel in pairs]


class Waveforms(TimedLog):
    """Channels that state the step of their samples; those with a start time count from 1970, in UTC."""

    def __init__(self, path: Path, numbers: dict[str, Any], facts: dict[str, dict[str, Any]]) -> None:
        self.path, self._numbers, self._facts = path, numbers, facts
        starts = [facts[name].get(START) for name in numbers]
        self._dated = all(start is not None for start in starts)

    def read(self, columns: Sequence[LogColumn]) -> list[LogSeries]:
        """Return the channels of these names."""
        for column in columns:
            if column.key not in self._numbers:
                has = f"no channel {column.key!r} with times; the file has {join_names(list(self._numbers))}"
                raise RecordingError(f"{self.path}: {has}")
        return [self._series(str(column.key)) for column in columns]

    def read_all(self) -> list[LogSeries]:
        """Return every channel."""
        return list(map(self._series, self._numbers))

    def _series(self, name: str) -> LogSeries:
        values, facts = self._numbers[name].astype(np.float64), self._facts[name]
        seconds = float(facts.get(OFFSET) or 0.0) + float(facts[STEP]) * np.arange(len(values))
        start = np.datetime64(facts[START], "ns").astype(np.int64) if self._dated else 0
        stamps = start + np.rint(seconds * 1e9).astype(np.int64)
        return LogSeries(name, stamps - min(0, int(stamps[0])), values, str(facts.get(UNIT) or ""), name)


class ChannelTable(FrameTable):
    """The channels of the usual length as columns, one of which may hold the times, as numbers or dates."""

    def __init__(self, path: Path, numbers: dict[str, Any], facts: dict[str, dict[str, Any]]) -> None:
        lengths = [len(values) for values in numbers.values()]
        usual = max(lengths, key=lengths.count)
        super().__init__({name: values for name, values in numbers.items() if len(values) == usual}, str(path))
        self._facts = facts

    def unit(self, key: str | int) -> str:
        """Return the unit that the channel states."""
        return str(self._facts[self.names[self._index(key, len(self.names))]].get(UNIT) or "")
