"""Strict parsing of JSON from a file or a topic: text in; plain values out, bounded in size.

Unlike the `json` module it rejects repeated keys, NaN, infinities, and strings that UTF-8 cannot encode.
"""

from __future__ import annotations

import json
import stat
from collections import Counter
from math import isfinite
from pathlib import Path
from typing import Any

from ces_observer.errors import ModelError

DEEPEST = 32
LONGEST_TEXT = 10_000
LARGEST_WHOLE = 2**63


def read_bounded(path: Path, max_bytes: int) -> str:
    """Return the text of a file, reading at most `max_bytes` and one more.

    Raises OSError, and ModelError naming the file if it is not a regular file, too large or not UTF-8.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ModelError(f"{path}: not a regular file; expected a JSON file")
    except ValueError as error:  # a NUL in the name
        raise ModelError(f"{str(path)!r}: not a file name: {error}") from None
    with path.open("rb") as file:
        raw = file.read(max_bytes + 1)
    if len(raw) > max_bytes:
        raise ModelError(f"{path}: too large; a model file has at most {max_bytes} bytes")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: not UTF-8 text: {error.reason} at byte {error.start}") from None


def parse_json(text: str, source: str) -> Any:
    """Return the values of a JSON text; `source` names it in errors. Raises ModelError."""
    try:
        values = json.loads(text, object_pairs_hook=_object)
    except RecursionError:
        raise _too_deep_error(source) from None
    except ValueError as error:
        raise ModelError(f"{source}: not a JSON file: {error}") from None
    _check(values, source, DEEPEST)
    return values


def _too_deep_error(where: str) -> ModelError:
    return ModelError(f"{where}: nested more than {DEEPEST} deep; expected a file that `ces identify` wrote")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"key {_shorten(twice)} occurs twice; keep one")
    return values


def _check(value: object, where: str, depth: int) -> None:
    """Raise ModelError at a value that is too deep, too long, too large, or cannot be written again."""
    match value:
        case str():
            _check_text(value, where)
        case dict() | list():
            _check_all(value, where, depth)
        case float() if not isfinite(value):
            raise ModelError(f"{where} is {value!r}; expected a finite number")
        case int() if abs(value) > LARGEST_WHOLE:
            raise ModelError(f"{where} is a whole number beyond 2^63; expected a smaller one")


def _check_all(values: dict[str, Any] | list[Any], where: str, depth: int) -> None:
    if depth == 0:
        raise _too_deep_error(where[:200])
    if isinstance(values, list):
        for i, value in enumerate(values):
            _check(value, f"{where}[{i}]", depth - 1)
        return
    for key, value in values.items():
        _check_text(key, where)
        _check(value, f"{where}: {key if len(key) < 40 and key.isprintable() else _shorten(key)}", depth - 1)


def _check_text(text: str, where: str) -> None:
    if len(text) > LONGEST_TEXT:
        raise ModelError(f"{where}: a string of {len(text)} characters; expected at most {LONGEST_TEXT}")
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ModelError(f"{where}: {_shorten(text)} has half of a surrogate pair; expected whole characters")


def _shorten(text: str) -> str:
    return repr(text[:40])
