"""Finds a signal's number in a serialised message, and the bytes that determine its place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ces_observer.cdr.types import JOINT_NAMES, ArrayPart, CdrUnsupportedError, MessagePart, NumberPart, Part
from ces_observer.cdr.walk import Span, Walk
from ces_observer.errors import SignalsError
from ces_observer.signals import FieldPath


@dataclass(frozen=True)
class FieldLayout:
    """The place of a number in messages of `length` bytes that have the same bytes in the spans `fixed`.

    `offset` and the spans (start, end) count from the first byte of the encapsulation; `code` is the number's type in
    the module struct. `runs` are the same spans joined across the meaningless padding between them.
    """

    length: int
    offset: int
    code: str
    fixed: tuple[Span, ...]
    runs: tuple[Span, ...]


def find_layout(raw: bytes, record: MessagePart, path: FieldPath) -> FieldLayout:
    """Find the number at `path` in a message of type `record`; the bytes after it are not checked.

    Raises SignalsError if the message is malformed before it or lacks the joint or element, and CdrUnsupportedError if
    the message has to be deserialised instead.
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
    """Move to the start of the field `name` or of its element, and return the type of that part."""
    part = record.fields[name]
    if element is None or not isinstance(part, ArrayPart):
        _skip_fields(walk, record, name, set())
        return part
    requested = set(JOINT_NAMES) & set(record.fields) if isinstance(element, str) else set()
    texts = _skip_fields(walk, record, name, requested)
    if isinstance(element, str):
        names = next((texts[field] for field in JOINT_NAMES if texts.get(field)), [])
        if element not in names:
            raise SignalsError(f"{walk.where}: no joint '{element}'; the message has {names or 'no names'}")
        element = names.index(element)
    count = walk.read_count(part)
    if element >= count:
        raise SignalsError(f"{walk.where}: index {element} is outside an array of {count}")
    walk.skip_elements(part.element, element)
    return part.element


def _skip_fields(walk: Walk, record: MessagePart, name: str, requested: set[str]) -> dict[str, list[str]]:
    """Move to the start of the field `name`; return the strings in the fields `requested`, before or after it."""
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


def _join_spans(spans: Iterable[Span], padding: Mapping[int, int]) -> tuple[Span, ...]:
    """Return the spans in order, joined where they touch or have only `padding` (start to end) between them."""
    joined: list[Span] = []
    for start, end in sorted(spans):
        before = joined[-1][1] if joined else -1
        if start <= max(before, padding.get(before, before)):
            joined[-1] = (joined[-1][0], max(end, before))
        else:
            joined.append((start, end))
    return tuple(joined)
