"""Writes an MCAP file message by message with the mcap library, the observer's only third-party library beside ROS 2.

Only this module imports it, and only if there is a black box. The file has the profile `ros2` and chunks without
compression; Foxglove, PlotJuggler, rosbags, rosbag2 and `mcap info` read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ces_observer import __version__
from ces_observer.errors import RecordingError

CHUNK_BYTES = 1 << 16  # smaller chunks end faster but make a longer summary: bench/bench_write.py


@dataclass(frozen=True)
class BagChannel:
    """A topic of a bag: its resolved name, message type, that type's `ros2msg` definition and, if known, its hash."""

    topic: str
    type: str
    definition: str
    type_hash: str = ""


def require_mcap() -> None:
    """Import the mcap library ahead of its use; raises RecordingError if it is not installed."""
    try:
        import mcap.writer  # noqa: F401
    except ImportError:
        raise RecordingError("the Python package mcap is missing; install it with: pip install mcap") from None


class McapFile:
    """Writes one file, complete after `close`; raises OSError.

    `counts` holds the number of messages of each channel, `start_ns` and `end_ns` their earliest and latest time.
    """

    def __init__(self, path: Path, channels: Sequence[BagChannel]) -> None:
        from mcap.writer import CompressionType, Writer

        self.counts = [0] * len(channels)
        self.start_ns = self.end_ns = 0
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE)
        self._writer.start("ros2", f"ces_observer {__version__}")
        definitions = {channel.type: channel.definition.encode() for channel in channels}
        schemas = {name: self._writer.register_schema(name, "ros2msg", text) for name, text in definitions.items()}
        self._ids = [
            self._writer.register_channel(
                channel.topic,
                "cdr",
                schemas[channel.type],
                {"offered_qos_profiles": "[]", "topic_type_hash": channel.type_hash},
            )
            for channel in channels
        ]

    def write(self, channel: int, log_ns: int, raw: bytes) -> None:
        """Write a message of the channel with this index, received at `log_ns` >= 0."""
        self.start_ns = min(self.start_ns, log_ns) if any(self.counts) else log_ns
        self.end_ns = max(self.end_ns, log_ns)
        self._writer.add_message(self._ids[channel], log_ns, raw, log_ns, self.counts[channel])
        self.counts[channel] += 1

    def close(self) -> None:
        """Write the rest and the summary, and close the file; further calls do nothing."""
        if not self._file.closed:
            with self._file:
                self._writer.finish()  # type: ignore[no-untyped-call]

    def abandon(self) -> None:
        """Close the file without completing it."""
        with suppress(OSError):
            self._file.close()
