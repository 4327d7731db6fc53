"""A message with a header and one number, serialised once and patched for each sample, at a third of the usual cost."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

STAMP, NUMBER = struct.Struct("<iI"), struct.Struct("<d")
PROBE = (1_234_567_890, 987_654_321, 0.123456789)  # their places in the bytes are the places to patch


class PatchedMessage:
    """Publishes `message` with a new stamp and number each time; `set_number` writes a number into it.

    If the probe is not found in the serialised bytes (another encapsulation), messages are published as usual.
    """

    def __init__(self, publisher: Publisher, message: Any, set_number: Callable[[float], None]) -> None:
        self._publish, self._message, self._set_number = publisher.publish, message, set_number
        self._fill(*PROBE)
        self._bytes = bytearray(serialize_message(message))
        self._stamp_at = _find_place(self._bytes, STAMP.pack(*PROBE[:2]))
        self._number_at = _find_place(self._bytes, NUMBER.pack(PROBE[2]))
        if self._stamp_at < 0 or self._number_at < 0:
            self.publish = self._publish_whole  # type: ignore[method-assign]

    def publish(self, sec: int, nanosec: int, number: float) -> None:
        """Publish a number with a stamp."""
        STAMP.pack_into(self._bytes, self._stamp_at, sec, nanosec)
        NUMBER.pack_into(self._bytes, self._number_at, number)
        self._publish(bytes(self._bytes))

    def _publish_whole(self, sec: int, nanosec: int, number: float) -> None:
        self._fill(sec, nanosec, number)
        self._publish(self._message)

    def _fill(self, sec: int, nanosec: int, number: float) -> None:
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = sec, nanosec
        self._set_number(number)


def _find_place(whole: bytearray, part: bytes) -> int:
    """Return the index of `part` in `whole`, or -1 unless it occurs exactly once."""
    return whole.find(part) if whole.count(part) == 1 else -1
