"""ROS 1 bags as logs: columns are a topic and a field, such as `/joint_states position[rear_damper]`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ces_identify.recordings.formats.log_file import LogSeries, TimedLog
from ces_identify.recordings.log_mapping import Column, MappingError
from ces_identify.recordings.topic_fields import read_fields, read_series


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
