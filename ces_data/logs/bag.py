"""ROS 1 bags as logs: columns are a topic and a field, such as `/joint_states position[rear_damper]`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ces_data.bags.fields import FieldSeries, read_fields, read_series
from ces_data.logs.log_file import LogSeries, Progress, TimedLog
from ces_data.logs.log_mapping import DynoMapping, LogColumn, MappingError


def open_log(path: Path, _: DynoMapping, __: Progress) -> BagLog:
    """Open a ROS 1 bag."""
    return BagLog(path)


class BagLog(TimedLog):
    """A ROS 1 bag."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, columns: Sequence[LogColumn]) -> list[LogSeries]:
        """Return the numbers at these topics and fields."""
        fields = []
        for key in (str(column.key) for column in columns):
            topic, _, field = map(str.strip, key.partition(" "))
            if not topic or not field:
                raise MappingError(
                    f"column {key!r}: expected topic and field, such as '/measured_force wrench.force.z'"
                )
            fields.append((topic, field))
        return _as_logged(read_series(self.path, fields))

    def read_all(self) -> list[LogSeries]:
        """Return the numbers of all topics."""
        return _as_logged(read_fields(self.path).series)


def _as_logged(series: Sequence[FieldSeries]) -> list[LogSeries]:
    labels = [f"{one.topic} {one.field}" for one in series]
    return [LogSeries(name, s.stamps_ns, s.values, key=name) for name, s in zip(labels, series, strict=True)]
