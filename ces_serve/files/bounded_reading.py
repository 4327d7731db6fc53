"""Reads files that anyone may have written: bounded in size, never executed; what is wrong with one is an error."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError

MAX_JSON_BYTES = 8_000_000
MAX_ROWS_BYTES = 64_000_000
HEAD_BYTES = 4096

Json = dict[str, Any]


class UnreadableError(CesError):
    """A file of ours that cannot be read; the message says why, without the path."""


def read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a regular file; raises UnreadableError or OSError."""
    return _read(path, count)


def read_json(path: Path) -> Json:
    """Return the object in a JSON file; raises UnreadableError or OSError."""
    raw = _read(path, MAX_JSON_BYTES + 1)
    if len(raw) > MAX_JSON_BYTES:
        raise UnreadableError(f"larger than {MAX_JSON_BYTES // 1_000_000} MB")
    return parse_object(raw)


def read_rows(path: Path) -> list[Json]:
    """Return the rows of a file with one JSON object a line; an incomplete last line is one that is being written."""
    raw = _read(path, MAX_ROWS_BYTES + 1)
    if len(raw) > MAX_ROWS_BYTES:
        raise UnreadableError(f"larger than {MAX_ROWS_BYTES // 1_000_000} MB")
    rows = []
    for number, line in enumerate(raw.rpartition(b"\n")[0].splitlines(), start=1):
        try:
            rows.append(parse_object(line))
        except UnreadableError as error:
            raise UnreadableError(f"line {number}: {error}") from None
    return rows


def parse_object(raw: bytes) -> Json:
    """Return the JSON object in a text; raises UnreadableError."""
    if not raw.strip():
        raise UnreadableError("empty")
    if b"\0" in raw:
        raise UnreadableError("binary data, not JSON")
    try:
        value = json.loads(raw)
    except UnicodeDecodeError as error:
        raise UnreadableError(f"not UTF-8 text: {error.reason} at byte {error.start}") from None
    except RecursionError:
        raise UnreadableError("nested too deep") from None
    except ValueError as error:
        raise UnreadableError(f"not complete JSON: {error}") from None
    if not isinstance(value, dict):
        raise UnreadableError("not a JSON object")
    return value


def _read(path: Path, count: int) -> bytes:
    if not stat.S_ISREG(path.stat().st_mode):  # opening a pipe would wait
        raise UnreadableError("not a regular file")
    with path.open("rb") as file:
        return file.read(count)
