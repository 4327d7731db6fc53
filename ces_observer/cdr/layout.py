"""Where the number of a signal lies in a serialised message, and which bytes fix that place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ces_observer.cdr.types import JOINT_NAMES, ArrayPart, CdrUnsupportedError, MessagePart, NumberPart, Part
from ces_observer.cdr.walk import Span, Walk
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath


@dataclass(frozen=True)
class FieldLayout:
    """The place of a number in messages of `length` bytes whose bytes in `fixed` are the same.

    `offset` and the spans (start, end) count from the first byte of the encapsulation; `code` is the number's for the
    module struct. `runs` are the same spans joined across the padding between them, whose bytes mean nothing.
    """

    length: int
    offset: int
    code: str
    fixed: tuple[Span, ...]
    runs: tuple[Span, ...]


def find_layout(raw: bytes, record: MessagePart, path: FieldPath) -> FieldLayout:
    """Find the number at `path` in a message of type `record`; what follows it is not looked at.

    Raises SignalsError if the message is malformed up to there, or lacks the joint or element asked for, and
    CdrUnsupportedError if this walk cannot tell.
    """
    walk = Walk(raw, f"field '{path.text}'")
    part: Part = record
    for name, element in path.steps:
        if isinstance(part, MessagePart):
            part = _enter(walk, part, name, element)
    if not isinstance(part, NumberPart):
        raise CdrUnsupportedError(f"field '{path.text}' is a {part.kind}")
    offset = walk.skip_numbers(part, 1)
    return FieldLayout(len(raw), offset, part.code, _join_spans(walk.fixed, {}), _join_spans(walk.fixed, walk.padding))


def _enter(walk: Walk, record: MessagePart, name: str, element: int | str | None) -> Part:
    """Go to the start of the field `name`, or of an element of it; returns what begins there."""
    part = record.fields[name]
    if element is None or not isinstance(part, ArrayPart):
        _skip_fields(walk, record, name, set())
        return part
    asked = set(JOINT_NAMES) & set(record.fields) if isinstance(element, str) else set()
    texts = _skip_fields(walk, record, name, asked)
    if isinstance(element, str):
        names = next((texts[field] for field in JOINT_NAMES if texts.get(field)), [])
        if element not in names:
            raise SignalsError(f"{walk.where}: no joint '{element}'; the message has {names or 'no names'}")
        element = names.index(element)
    _skip_elements(walk, part, element)
    return part.element


def _skip_fields(walk: Walk, record: MessagePart, name: str, requested: set[str]) -> dict[str, list[str]]:
    """Go to the start of the field `name`; returns the strings in the fields `requested`, wherever they are."""
    texts: dict[str, list[str]] = {}
    start = -1
    for field, part in record.fields.items():
        start = walk.at if field == name else start
        if start >= 0 and len(texts) == len(requested):
            break
        if field in requested:
            texts[field] = walk.read_texts(part)
        else:
            walk.skip(part)
    walk.at = start
    return texts


def _skip_elements(walk: Walk, many: ArrayPart, index: int) -> None:
    count = walk.read_count(many)
    if index >= count:
        raise SignalsError(f"{walk.where}: index {index} is outside an array of {count}")
    walk.skip_elements(many.element, index)


def _join_spans(spans: Iterable[Span], padding: Mapping[int, int]) -> tuple[Span, ...]:
    """Return the spans in order; joined where they touch or have only padding (its ends by its starts) between them."""
    joined: list[Span] = []
    for start, end in sorted(spans):
        before = joined[-1][1] if joined else -1
        if start <= max(before, padding.get(before, before)):
            joined[-1] = (joined[-1][0], max(end, before))
        else:
            joined.append((start, end))
    return tuple(joined)
