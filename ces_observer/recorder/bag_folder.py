"""Writes a rosbag2 folder, an MCAP file and metadata.yaml, which gets its name only when it is complete."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from ces_observer.recorder.mcap_file import BagChannel, McapFile

VERSION = 9  # of metadata.yaml, that of Jazzy
METADATA = "metadata.yaml"
PART = ".part"


class BagFolder:
    """Writes the bag `path` in a hidden folder beside it, which `place` renames; raises OSError.

    `notes` become the bag's custom data. Call `write` for each message, then `end` and `place`.
    """

    def __init__(self, path: Path, channels: Sequence[BagChannel], notes: Mapping[str, str]) -> None:
        self.path = path
        self._channels = channels
        self._notes = dict(notes)
        self._part = part_path(path)
        self._part.mkdir(parents=True)
        self._file = McapFile(self._part / f"{path.name}.mcap", channels)
        self.write = self._file.write  # takes (channel, log_ns, raw); direct, as it is called with every message

    def end(self) -> None:
        """Complete the files."""
        self._file.close()
        text = metadata_text(self.path.name, self._channels, self._file, self._notes)
        (self._part / METADATA).write_text(text, encoding="utf-8")

    def place(self) -> None:
        """Rename the bag once it is on the disk; waits for the disk."""
        for path in (*self._part.iterdir(), self._part):
            handle = os.open(path, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        self._part.rename(self.path)

    def abandon(self) -> None:
        """Remove what was written."""
        self._file.abandon()
        remove_bag(self._part)


def part_path(path: Path) -> Path:
    """Return the hidden folder in which the bag `path` is written."""
    return path.with_name(f".{path.name}{PART}")


def remove_bag(path: Path) -> None:
    """Remove a bag's folder and files; raises OSError if it holds other files."""
    for file in (*path.glob("*.mcap"), path / METADATA):
        file.unlink(missing_ok=True)
    path.rmdir()


def metadata_text(name: str, channels: Sequence[BagChannel], file: McapFile, notes: Mapping[str, str]) -> str:
    """Return the text of metadata.yaml, with times of receipt."""
    total, start_ns, length_ns = sum(file.counts), file.start_ns, file.end_ns - file.start_ns
    topics = "".join(_format_topic(channel, count) for channel, count in zip(channels, file.counts, strict=True))
    custom = "".join(f"\n    {_quote(key)}: {_quote(value)}" for key, value in notes.items()) or " {}"
    return f"""rosbag2_bagfile_information:
  version: {VERSION}
  storage_identifier: mcap
  duration:
    nanoseconds: {length_ns}
  starting_time:
    nanoseconds_since_epoch: {start_ns}
  message_count: {total}
  topics_with_message_count:{topics or " []"}
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - {_quote(f"{name}.mcap")}
  files:
    - path: {_quote(f"{name}.mcap")}
      starting_time:
        nanoseconds_since_epoch: {start_ns}
      duration:
        nanoseconds: {length_ns}
      message_count: {total}
  custom_data:{custom}
  ros_distro: {_quote(os.environ.get("ROS_DISTRO", ""))}
"""


def _format_topic(channel: BagChannel, count: int) -> str:
    return f"""
    - topic_metadata:
        name: {_quote(channel.topic)}
        type: {_quote(channel.type)}
        serialization_format: cdr
        offered_qos_profiles: []
        type_description_hash: {_quote(channel.type_hash)}
      message_count: {count}"""


def _quote(text: str) -> str:
    """Return a YAML double-quoted scalar, which is a JSON string."""
    return json.dumps(text, ensure_ascii=False)
