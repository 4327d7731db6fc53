"""The messages of the ride as bytes, so that a publisher in Python reaches 10 kHz and can publish invalid bytes.

Layouts come from messages serialised by the middleware's own code, not by this project's.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from random import Random

from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

JOINT = "rear_damper"
HEADER = b"\x00\x01\x00\x00"  # CDR, little-endian
ENCODINGS = (b"\x00\x00\x00\x00", b"\x00\x03\x00\x00", b"\x00\x07\x00\x00", b"\x00\x0b\x00\x00")  # others
STAMP_AT = len(HEADER)
SENTINEL = 1.2345678901234567
STAMP = struct.Struct("<iI")
DOUBLE = struct.Struct("<d")


class JointWire:
    """JointStates of fixed joints, in which only the stamp and the last joint's position change."""

    def __init__(self, names: Sequence[str]) -> None:
        message = JointState(name=list(names), position=[0.0] * (len(names) - 1) + [SENTINEL])
        message.header.frame_id = "chassis"
        self._bytes = bytearray(serialize_message(message))
        self._position_at = self._bytes.index(DOUBLE.pack(SENTINEL))

    def message(self, stamp_ns: int, position_m: float) -> bytes:
        """Return the bytes of one message."""
        STAMP.pack_into(self._bytes, STAMP_AT, *divmod(stamp_ns, 10**9))
        DOUBLE.pack_into(self._bytes, self._position_at, position_m)
        return bytes(self._bytes)


def read_estimate(message: bytes) -> tuple[int, float, float, float]:
    """Return stamp [ns], position, speed and force of one joint: the numbers end the message, each after its count."""
    seconds, nanoseconds = STAMP.unpack_from(message, STAMP_AT)
    position, speed, force = (DOUBLE.unpack_from(message, len(message) - back)[0] for back in (40, 24, 8))
    return seconds * 10**9 + nanoseconds, position, speed, force


def float64(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return HEADER + DOUBLE.pack(value)


def clock(now_ns: int) -> bytes:
    """Return a rosgraph_msgs/Clock."""
    return HEADER + STAMP.pack(*divmod(now_ns, 10**9))


def no_float64(dice: Random) -> bytes:
    """Return bytes too short for a Float64, in whole words as DDS sends them."""
    return HEADER + dice.randbytes(dice.randrange(5))


def no_joint_state(good: bytes, dice: Random) -> bytes:
    """Return bytes that are not a JointState: cut short, of random content, with absurd lengths or another encoding."""
    kind = dice.randrange(5)
    if kind == 0:
        return good[: dice.randrange(4, len(good) // 2)]
    if kind == 1:
        return HEADER + dice.randbytes(dice.randrange(300))
    if kind == 2:
        return good[:12] + b"\xff\xff\xff\x7f" + good[16:]
    if kind == 3:
        return dice.choice(ENCODINGS) + good[4:12] + dice.randbytes(len(good) - 12)
    return HEADER + b"\xff" * dice.randrange(64)
