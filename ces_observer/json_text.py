"""Untrusted JSON from a file or a topic, parsed strictly; files written as a whole or not at all.

Values are bounded in size and depth. Unlike the `json` module, `parse_json` rejects repeated keys, NaN, infinities, and
strings that UTF-8 cannot encode.
"""

from __future__ import annotations

import atexit
import json
import os
import stat
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from errno import ENOSPC
from math import isfinite
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError, ModelError

DEEPEST = 32
LONGEST_TEXT = 10_000
LARGEST_WHOLE = 2**63


def read_bounded(path: Path, max_bytes: int) -> str:
    """Return the text of a file, reading at most `max_bytes` and one more.

    Raises OSError, and ModelError naming the file if it is not a regular file, too large or not UTF-8.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ModelError(f"{path}: not a regular file, such as a recording; expected a JSON file")
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
        raise ValueError(f"key {_start_of(twice)} occurs twice; keep one")
    return values


def _check(value: object, where: str, depth: int) -> None:
    """Raise ModelError at a value that is too deep, too long, too large, or cannot be written again."""
    if isinstance(value, dict | list) and depth == 0:
        raise _too_deep_error(where[:200])
    match value:
        case str():
            _check_text(value, where)
        case list():
            for i, one in enumerate(value):
                _check(one, f"{where}[{i}]", depth - 1)
        case dict():
            for key, one in value.items():
                _check_text(key, where)
                _check(one, f"{where}: {key if len(key) < 40 and key.isprintable() else _start_of(key)}", depth - 1)
        case float() if not isfinite(value):
            raise ModelError(f"{where} is {value!r}; expected a finite number")
        case int() if abs(value) > LARGEST_WHOLE:
            raise ModelError(f"{where} is a whole number beyond 2^63; expected a smaller one")


def _check_text(text: str, where: str) -> None:
    if len(text) > LONGEST_TEXT:
        raise ModelError(f"{where}: a string of {len(text)} characters; expected at most {LONGEST_TEXT}")
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ModelError(f"{where}: {_start_of(text)} has half of a surrogate pair; expected whole characters")


def _start_of(text: str) -> str:
    return repr(text[:40])


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write `content` (a string as UTF-8) to a temporary file beside `path` and rename that.

    Raises CesError naming the path if the folder is missing, read-only or full; `path` is then unchanged.
    """
    write_all_atomically({Path(path): content})


def write_all_atomically(files: Mapping[Path, str | bytes]) -> None:
    """Write files that belong together like `write_atomically`: none is renamed before all are written."""
    ready: dict[Path, Path] = {}

    def remove() -> None:
        for temporary in ready.values():
            temporary.unlink(missing_ok=True)

    atexit.register(remove)  # for an end by a signal
    try:
        for path, content in files.items():
            _write_temporary(path, content, ready)
        for path, temporary in ready.items():
            with explain_write_errors(path):
                temporary.replace(path)
    finally:
        remove()
        atexit.unregister(remove)


def _write_temporary(path: Path, content: str | bytes, ready: dict[Path, Path]) -> None:
    """Write a temporary file beside `path`; `ready` names it as soon as it exists."""
    with explain_write_errors(path):
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        ready[path] = Path(temporary)
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        ready[path].chmod(path.stat().st_mode & 0o777 if path.is_file() else 0o644)


@contextmanager
def explain_write_errors(path: Path) -> Iterator[None]:
    """Raise CesError naming `path`, and what to do, for an OSError inside the block."""
    try:
        yield
    except OSError as error:
        full = error.errno == ENOSPC
        advice = "free space there and run the same command" if full else "choose a writable folder"
        raise CesError(f"{path}: cannot be written: {error.strerror}; {advice}") from None


def quote(value: object) -> str:
    """Return a value as errors quote it: on one line and short."""
    try:
        text = repr(value[:60] if isinstance(value, str) else value)
    except ValueError:  # a whole number of thousands of digits
        text = f"a {type(value).__name__} too large to write"
    return text if len(text) <= 62 else text[:59] + "..."
