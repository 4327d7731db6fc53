"""Decodes many raw messages at once with NumPy if their layout is the same, otherwise one by one.

The lengths, string terminators and joint names in a serialised message determine the offsets of its numbers. Messages
with the same bytes there share a `MessageLayout`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Index = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LAYOUTS_PER_LENGTH = 16  # a topic with more layouts of one length, such as joint orders, is read one by one


@dataclass(frozen=True)
class Block:
    """n raw messages in one buffer, in recorded order.

    `buffer` uint8; `topics` (the storage's number of the topic), `log_ns` (time logged), `starts` and `lengths`
    (of the payload in the buffer [bytes]), all int64 of shape (n,).
    """

    buffer: Bytes
    topics: Index
    log_ns: Index
    starts: Index
    lengths: Index

    @classmethod
    def join(cls, payloads: Sequence[bytes], topics: Index, log_ns: Index) -> Block:
        """Return the block of these messages."""
        lengths = np.array([len(payload) for payload in payloads], dtype=np.int64)
        buffer = np.frombuffer(b"".join(payloads) or b"\0", dtype=np.uint8)
        return cls(buffer, topics, log_ns, np.cumsum(lengths) - lengths, lengths)

    def select_topics(self, topics: Sequence[int]) -> Block:
        """Return the messages of these topics."""
        keep = np.isin(self.topics, topics)
        return Block(self.buffer, self.topics[keep], self.log_ns[keep], self.starts[keep], self.lengths[keep])

    def payload(self, i: int) -> bytes:
        """Return the bytes of message i."""
        return self.buffer[self.starts[i] : self.starts[i] + self.lengths[i]].tobytes()

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True)
class NumberField:
    """Offset from the message's start [bytes] and type of one number."""

    offset: int
    dtype: np.dtype[np.generic]

    def read(self, buffer: Bytes, starts: Index) -> Floats:
        """Return the number in each of the messages at `starts`, shape (n,)."""
        places = starts[:, None] + (self.offset + np.arange(self.dtype.itemsize))
        return np.asarray(buffer[places].view(self.dtype)[:, 0].astype(np.float64))


@dataclass(frozen=True)
class MessageLayout:
    """The offsets of the requested numbers, and the bytes that determine them.

    `fixed` (k,) are the positions of these bytes, `expected` (k,) their values. `numbers` has an entry for each
    requested number: its offset and type, or the reason (str) why messages of this layout do not have it.
    """

    fixed: Index
    expected: Bytes
    numbers: tuple[NumberField | str, ...]

    def fits(self, buffer: Bytes, starts: Index) -> Mask:
        """Return which of the messages at `starts`, all of the described one's length, have this layout; (n,)."""
        return np.asarray((buffer[starts[:, None] + self.fixed] == self.expected).all(axis=1))


Describe = Callable[[bytes], MessageLayout | None]
ReadOne = Callable[[bytes], list[float | str]]


class BulkDecoder:
    """Reads the same few numbers from every message of a topic.

    `describe` returns the layout of a raw message, or None if it is unknown; `read_one` returns the numbers of a raw
    message, or the reason (str) for each that it does not have. Their errors pass through.
    """

    def __init__(self, width: int, describe: Describe, read_one: ReadOne) -> None:
        self.width = width
        self.reasons: list[str] = [""] * width
        self._describe = describe
        self._read_one = read_one
        self._layouts: dict[int, list[MessageLayout]] = {}
        self._one_by_one: set[int] = set()

    def decode(self, block: Block) -> tuple[Floats, Mask]:
        """Return the numbers of the n messages of a block and a mask of those present, both of shape (n, width).

        `reasons` keeps the first reason why a number is missing.
        """
        values = np.full((len(block), self.width), np.nan)
        present = np.zeros((len(block), self.width), dtype=np.bool_)
        for length in np.unique(block.lengths):
            rows = np.flatnonzero(block.lengths == length)
            for layout in self._layouts.setdefault(int(length), []):
                rows = self._fill(layout, block, rows, values, present)
            self._learn(int(length), block, rows, values, present)
        return values, present

    def _learn(self, length: int, block: Block, rows: Index, values: Floats, present: Mask) -> None:
        """Read the rows by new layouts, or one by one if there is none."""
        known = self._layouts[length]
        while len(rows) and len(known) < LAYOUTS_PER_LENGTH and length not in self._one_by_one:
            layout = self._describe(block.payload(rows[0]))
            if layout is None:
                self._one_by_one.add(length)
                break
            known.append(layout)
            rows = self._fill(layout, block, rows, values, present)
        for row in rows:
            numbers = self._read_one(block.payload(row))
            for i, number in enumerate(numbers):
                self._note(i, number)
                present[row, i] = not isinstance(number, str)
                values[row, i] = np.nan if isinstance(number, str) else number

    def _fill(self, layout: MessageLayout, block: Block, rows: Index, values: Floats, present: Mask) -> Index:
        """Read the rows that have this layout; return the others."""
        if not len(rows):
            return rows
        fits = layout.fits(block.buffer, block.starts[rows])
        mine = rows[fits]
        for i, number in enumerate(layout.numbers):
            self._note(i, number)
            if not isinstance(number, str):
                values[mine, i] = number.read(block.buffer, block.starts[mine])
                present[mine, i] = True
        return rows[~fits]

    def _note(self, i: int, number: NumberField | float | str) -> None:
        if isinstance(number, str) and not self.reasons[i]:
            self.reasons[i] = number
