"""ROS 1 bags as logs: columns are a topic and a field, such as `/joint_states position[rear_damper]`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ces_data.bags.fields import read_fields, read_series
from ces_data.logs.log_file import LogSeries, TimedLog
from ces_data.logs.log_mapping import Column, DynoMapping, MappingError


def open_log(path: Path, _: DynoMapping, __: Callable[[float], None]) -> BagLog:
    """Open a ROS 1 bag."""
    return BagLog(path)


class BagLog(TimedLog):
    """A ROS 1 bag."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, columns: Sequence[Column]) -> list[LogSeries]:
        """Return the numbers at these topics and fields."""
        found = read_series(self.path, [_split(column) for column in columns])
        return [LogSeries(f"{s.topic} {s.field}", s.stamps_ns, s.values, key=f"{s.topic} {s.field}") for s in found]

    def read_all(self) -> list[LogSeries]:
        """Return the numbers of all topics."""
        return [
            LogSeries(f"{s.topic} {s.field}", s.stamps_ns, s.values, key=f"{s.topic} {s.field}")
            for s in read_fields(self.path).series
        ]


def _split(column: Column) -> tuple[str, str]:
    topic, _, field = str(column.key).partition(" ")
    if not topic or not field.strip():
        raise MappingError(f"column {column.key!r}: expected topic and field, such as '/measured_force wrench.force.z'")
    return topic, field.strip()
