"""Reads one signal directly from serialised messages: bytes in; stamp, SI value and frame out.

The first message of a layout is parsed and gives a template: which bytes determine the layout, and where stamp and
number are. The next messages are compared with the template in one or two operations and read at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Any

from ces_observer.cdr.layout import (
    ENCAPSULATION,
    CdrUnsupportedError,
    FieldLayout,
    FieldsOf,
    find_layout,
    find_number,
    parse_message_type,
)
from ces_observer.signals import ElementNames, Signal

Reading = tuple[int | None, float, bytes]  # header stamp [ns], value [SI], frame id as UTF-8
HEADER = "std_msgs/Header"
STAMP_END = ENCAPSULATION + 8  # seconds and nanoseconds, 4 bytes each
MAX_TEMPLATES = 4  # layouts: publishers that differ in frame or joint order may share a topic


@dataclass(frozen=True)
class Template:
    """A layout prepared for fast reading.

    `unpack` returns the encapsulation as a number, seconds and nanoseconds (these three only if stamped), the bytes of
    the first run of fixed bytes, and the number; `others` are the other runs.
    """

    length: int
    unpack: Callable[[bytes], tuple[Any, ...]]
    word: int
    run: bytes
    others: tuple[tuple[slice, bytes], ...]
    frame_id: bytes
    fixed: int  # the fixed bytes as one number, all others 0
    mask: int

    @property
    def fast_path(self) -> tuple[Any, ...]:
        """The attributes that a reading needs, in the order of use."""
        return self.length, self.unpack, self.run, self.others, self.word, self.frame_id

    def fits(self, raw: bytes) -> bool:
        """Compare the fixed bytes alone: some writers leave arbitrary bytes in the padding between them."""
        return len(raw) == self.length and int.from_bytes(raw, "little") & self.mask == self.fixed


class RawSignal:
    """Reader of a signal; `read(raw)` returns stamp [ns] (None if unstamped), value [SI] and frame id (empty if none).

    `read` raises SignalsError if the message is malformed before the number, lacks the joint or element, or has another
    joint at an index than the first message, and
    CdrUnsupportedError if the message has to be deserialised instead. The bytes after the number are not checked. The
    constructor raises SignalsError if messages of this type have no number at the signal's field, and
    CdrUnsupportedError if no message of this type can be read here.
    """

    def __init__(self, signal: Signal, fields_of: FieldsOf) -> None:
        self._record = parse_message_type(signal.type, fields_of)
        find_number(self._record, signal.field)
        header = self._record.fields.get("header")
        self.stamped = header is not None and header.kind == HEADER
        first = next(iter(self._record.fields))
        if self.stamped and (first != "header" or signal.field.steps[0][0] == "header"):
            raise CdrUnsupportedError(f"field '{signal.field.text}': the header of {signal.type} is not before it")
        self.read: Callable[[bytes], Reading] = self._read_stamped if self.stamped else self._read_unstamped
        self._path, self._names = signal.field, ElementNames(signal.field)
        self._scale = float(signal.scale)
        self._offset = float(signal.offset)
        self._templates: tuple[Template, ...] = ()
        self._last: tuple[Any, ...] = (-1, *[None] * 5)  # fast_path of the last template used

    def _read_stamped(self, raw: bytes) -> Reading:
        length, unpack, run, others, word, frame_id = self._last
        if len(raw) == length:
            first_word, sec, nanosec, fixed, number = unpack(raw)
            if fixed == run and first_word == word and (not others or _parts_match(others, raw)):
                return sec * 1_000_000_000 + nanosec, self._scale * number + self._offset, frame_id
        return self._read_new_layout(raw)

    def _read_unstamped(self, raw: bytes) -> Reading:
        length, unpack, run, others, _, _ = self._last
        if len(raw) == length:
            fixed, number = unpack(raw)
            if fixed == run and (not others or _parts_match(others, raw)):
                return None, self._scale * number + self._offset, b""
        return self._read_new_layout(raw)

    def _read_new_layout(self, raw: bytes) -> Reading:
        template = next((known for known in self._templates if known.fits(raw)), None)
        if template is None:
            layout = find_layout(raw, self._record, self._path)
            self._names.require(layout.by_names)
            template = _make_template(raw, layout, self.stamped)
            self._templates = (template, *self._templates[: MAX_TEMPLATES - 1])
        self._last = template.fast_path
        *start, _, number = template.unpack(raw)
        stamp_ns = start[1] * 1_000_000_000 + start[2] if self.stamped else None
        return stamp_ns, self._scale * number + self._offset, template.frame_id


def _parts_match(parts: tuple[tuple[slice, bytes], ...], raw: bytes) -> bool:
    for part, expected in parts:  # noqa: SIM110  # all() with a generator takes three times as long
        if raw[part] != expected:
            return False
    return True


def _make_template(raw: bytes, layout: FieldLayout, stamped: bool) -> Template:
    """Return the template of a message; the first run after the stamp begins with the frame id's length."""
    first, *others = layout.runs[1:] if stamped else layout.runs
    start, end = first
    mask = bytearray(layout.fixed[-1][1])
    for span in layout.fixed:
        mask[slice(*span)] = b"\xff" * (span[1] - span[0])
    mask_number = int.from_bytes(mask, "little")
    frame = STAMP_END + 4
    frame_length = int.from_bytes(raw[STAMP_END:frame], "little")
    form = f"{'<IiI' if stamped else '<'}{end - start}s{layout.offset - end}x{layout.code}"
    return Template(
        length=layout.length,
        unpack=Struct(form).unpack_from,
        word=int.from_bytes(raw[:ENCAPSULATION], "little"),
        run=raw[start:end],
        others=tuple((slice(*span), raw[slice(*span)]) for span in others),
        frame_id=raw[frame : frame + max(frame_length - 1, 0)] if stamped else b"",
        fixed=int.from_bytes(raw, "little") & mask_number,
        mask=mask_number,
    )
