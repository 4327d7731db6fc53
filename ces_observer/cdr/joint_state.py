"""Writes estimates and bands as serialised sensor_msgs/JointState: numbers in, bytes out."""

from __future__ import annotations

import struct
from struct import Struct

from ces_observer.errors import SignalsError

LITTLE_CDR = b"\x00\x01\x00\x00"
NO_ITEMS = struct.pack("<I", 0)  # the length of a sequence
ONE = struct.pack("<I", 1)
TWO = struct.pack("<I", 2)


class RawEstimate:
    """Writes estimates of the joint `name`; all bytes but the numbers are prepared once for each frame id."""

    def __init__(self, name: str) -> None:
        self._name = name.encode()
        self._lay_out(b"")

    def fill(self, stamp_ns: int, frame_id: bytes, position: float, speed: float, force: float) -> bytes:
        """Return the message with position [m], velocity [m/s] and effort [N]; `frame_id` is UTF-8.

        Raises SignalsError if the stamp is out of the range of builtin_interfaces/Time (int32 seconds).
        """
        if frame_id != self._frame_id:
            self._lay_out(frame_id)
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        try:
            return self._pack(LITTLE_CDR, sec, nanosec, self._names, position, self._next, speed, self._next, force)
        except struct.error:
            raise _stamp_error(stamp_ns) from None

    def _lay_out(self, frame_id: bytes) -> None:
        """Prepare the bytes between the numbers, aligned from the end of the encapsulation and padded with zeros."""
        self._names = _pad_to(_encode_names(frame_id, self._name) + ONE, 8)
        self._next = _pad_to(ONE, 8)
        self._frame_id = frame_id
        self._pack = Struct(f"<4siI{len(self._names)}sd8sd8sd").pack


class RawBand:
    """Writes the bounds of the joint `name` as the efforts of two joints, NAME_lower and NAME_upper."""

    def __init__(self, name: str) -> None:
        self.names = (f"{name}_lower", f"{name}_upper")
        self._lay_out(b"")

    def fill(self, stamp_ns: int, frame_id: bytes, lower: float, upper: float) -> bytes:
        """Return the message with both bounds [N]; `frame_id` is UTF-8. Raises SignalsError as `RawEstimate.fill`."""
        if frame_id != self._frame_id:
            self._lay_out(frame_id)
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        try:
            return self._pack(LITTLE_CDR, sec, nanosec, self._head, lower, upper)
        except struct.error:
            raise _stamp_error(stamp_ns) from None

    def _lay_out(self, frame_id: bytes) -> None:
        names = _encode_names(frame_id, *(name.encode() for name in self.names))
        self._head = _pad_to(names + NO_ITEMS + NO_ITEMS + TWO, 8)  # without positions and velocities
        self._frame_id = frame_id
        self._pack = Struct(f"<4siI{len(self._head)}sdd").pack


def _stamp_error(stamp_ns: int) -> SignalsError:
    return SignalsError(f"stamp {stamp_ns} ns is out of the range of a header stamp")


def _encode_names(frame_id: bytes, *names: bytes) -> bytes:
    """Return the frame id and the sequence of joint names; both begin at a multiple of 8, after a stamp."""
    out = _pad_to(_encode_text(frame_id), 4) + struct.pack("<I", len(names))
    for name in names:
        out = _pad_to(out + _encode_text(name), 4)
    return out


def _encode_text(text: bytes) -> bytes:
    return struct.pack("<I", len(text) + 1) + text + b"\0"


def _pad_to(part: bytes, size: int) -> bytes:
    """Return `part`, which begins at a multiple of 8, padded to a multiple of `size`."""
    return part + bytes(-len(part) % size)
