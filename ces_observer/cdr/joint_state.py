"""Writes estimates and bands as serialised sensor_msgs/JointState: numbers in, bytes out."""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from struct import Struct
from typing import Any

from ces_observer.errors import SignalsError

LITTLE_CDR = b"\x00\x01\x00\x00"
FIELDS = ("position", "velocity", "effort")  # sequences of numbers, in the order of the message


class RawJointState:
    """Writes the states of the joints `names`; only the sequences in `fields` have numbers, one for each joint.

    There is one joint, or one such sequence. All bytes but the numbers are prepared once for each frame id.
    """

    def __init__(self, names: Sequence[str], fields: Collection[str] = FIELDS) -> None:
        self._names = [_encode_text(name.encode()) for name in names]
        self._fields = fields
        self._places = slice(4, None, 2 if len(names) == 1 else 1)  # of the numbers in `_items`
        self._lay_out(b"")

    def fill(self, stamp_ns: int, frame_id: bytes, *numbers: float) -> bytes:
        """Return the message with the numbers [m, m/s, N], one sequence after the other; `frame_id` is UTF-8.

        Raises SignalsError if the stamp is out of the range of builtin_interfaces/Time (int32 seconds).
        """
        if frame_id != self._frame_id:
            self._lay_out(frame_id)
        items = self._items
        items[1], items[2] = divmod(stamp_ns, 1_000_000_000)
        items[self._places] = numbers
        try:
            return self._pack(*items)
        except struct.error:
            raise SignalsError(f"stamp {stamp_ns} ns is out of the range of a header stamp") from None

    def _lay_out(self, frame_id: bytes) -> None:
        """Prepare the bytes before each sequence, aligned from the end of the encapsulation and padded with zeros."""
        count = struct.pack("<I", len(self._names))
        part = _pad_to(_encode_text(frame_id), 4) + count
        for name in self._names:
            part = _pad_to(part + name, 4)
        self._items: list[Any] = [LITTLE_CDR, 0, 0]
        form = "<4siI"
        for field in FIELDS:
            if field in self._fields:
                part = _pad_to(part + count, 8)
                self._items += [part, *[0.0] * len(self._names)]
                form += f"{len(part)}s{len(self._names)}d"
                part = b""
            else:
                part += struct.pack("<I", 0)
        self._frame_id = frame_id
        self._pack = Struct(form + f"{len(part)}x").pack


def _encode_text(text: bytes) -> bytes:
    return struct.pack("<I", len(text) + 1) + text + b"\0"


def _pad_to(part: bytes, size: int) -> bytes:
    """Return `part`, which begins at a multiple of 8, padded to a multiple of `size`."""
    return part + bytes(-len(part) % size)
